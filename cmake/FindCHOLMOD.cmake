# Debian's SuiteSparse 5 ships no CMake package for CHOLMOD. Defines the target CHOLMOD::CHOLMOD, with OpenBLAS and the
# OpenMP runtime: CHOLMOD calls both, and linalg/sequential_blas limits their threads.
find_path(CHOLMOD_INCLUDE_DIR cholmod.h PATH_SUFFIXES suitesparse)
find_library(CHOLMOD_LIBRARY cholmod)
find_library(CHOLMOD_OPENBLAS_LIBRARY openblas)
find_package(OpenMP QUIET COMPONENTS CXX)
if(CHOLMOD_INCLUDE_DIR)
  file(STRINGS ${CHOLMOD_INCLUDE_DIR}/cholmod_core.h numbers REGEX "define CHOLMOD_(MAIN|SUB|SUBSUB)_VERSION [0-9]+")
  string(REGEX REPLACE "[^0-9;]" "" numbers "${numbers}")
  string(REPLACE ";" "." CHOLMOD_VERSION "${numbers}")
endif()
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(CHOLMOD VERSION_VAR CHOLMOD_VERSION REQUIRED_VARS CHOLMOD_LIBRARY CHOLMOD_OPENBLAS_LIBRARY OpenMP_gomp_LIBRARY
                                  CHOLMOD_INCLUDE_DIR)
if(CHOLMOD_FOUND AND NOT TARGET CHOLMOD::CHOLMOD)
  add_library(CHOLMOD::CHOLMOD INTERFACE IMPORTED)
  # OpenBLAS first: Ceres also links ATLAS, and the BLAS that is linked first serves all callers.
  set_target_properties(CHOLMOD::CHOLMOD PROPERTIES INTERFACE_INCLUDE_DIRECTORIES ${CHOLMOD_INCLUDE_DIR}
                                                    INTERFACE_LINK_LIBRARIES
                                                    "${CHOLMOD_OPENBLAS_LIBRARY};${CHOLMOD_LIBRARY};${OpenMP_gomp_LIBRARY}")
endif()
mark_as_advanced(CHOLMOD_INCLUDE_DIR CHOLMOD_LIBRARY CHOLMOD_OPENBLAS_LIBRARY)
