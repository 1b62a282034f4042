# Debian's SuiteSparse 5 ships no CMake package for CHOLMOD. Defines the target CHOLMOD::CHOLMOD, with the BLAS and LAPACK
# that CHOLMOD itself is linked with: another implementation beside them would start threads of its own.
find_path(CHOLMOD_INCLUDE_DIR cholmod.h PATH_SUFFIXES suitesparse)
find_library(CHOLMOD_LIBRARY cholmod)
find_library(CHOLMOD_LAPACK_LIBRARY lapack)
find_library(CHOLMOD_BLAS_LIBRARY blas)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(CHOLMOD REQUIRED_VARS CHOLMOD_LIBRARY CHOLMOD_LAPACK_LIBRARY
                                  CHOLMOD_BLAS_LIBRARY CHOLMOD_INCLUDE_DIR)
if(CHOLMOD_FOUND AND NOT TARGET CHOLMOD::CHOLMOD)
  add_library(CHOLMOD::CHOLMOD UNKNOWN IMPORTED)
  set_target_properties(CHOLMOD::CHOLMOD PROPERTIES IMPORTED_LOCATION ${CHOLMOD_LIBRARY}
                                                    INTERFACE_INCLUDE_DIRECTORIES ${CHOLMOD_INCLUDE_DIR}
                                                    INTERFACE_LINK_LIBRARIES
                                                    "${CHOLMOD_LAPACK_LIBRARY};${CHOLMOD_BLAS_LIBRARY}")
endif()
mark_as_advanced(CHOLMOD_INCLUDE_DIR CHOLMOD_LIBRARY CHOLMOD_LAPACK_LIBRARY CHOLMOD_BLAS_LIBRARY)
