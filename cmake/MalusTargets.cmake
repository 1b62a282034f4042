# Compile settings shared by every target of the project.
add_library(malus_settings INTERFACE)
target_compile_features(malus_settings INTERFACE cxx_std_20)
target_compile_options(malus_settings INTERFACE -Wall -Wextra -Wpedantic -Wshadow $<$<BOOL:${MALUS_WERROR}>:-Werror>)
# GCC 12 warns about its own std::string (bug 105651).
target_compile_options(malus_settings INTERFACE $<$<CXX_COMPILER_ID:GNU>:-Wno-restrict>)
if(MALUS_SANITIZE)
  # In instrumented code GCC 12 warns about its own <regex> and <functional>.
  target_compile_options(malus_settings INTERFACE -fsanitize=${MALUS_SANITIZE} -fno-omit-frame-pointer
                                                  -Wno-maybe-uninitialized)
  target_link_options(malus_settings INTERFACE -fsanitize=${MALUS_SANITIZE})
  # Under AddressSanitizer Eigen would align memory by itself, and Debian's Ceres would free it as memory of malloc.
  target_compile_definitions(malus_settings INTERFACE EIGEN_MALLOC_ALREADY_ALIGNED=1)
endif()

# Adds a room: the sources in cpp/malus/<name>, and their dependencies. DEPENDS names the rooms that they may use and so
# states the dependency direction; PRIVATE names libraries that must not appear in a public header.
# MALUS_ROOMS_<name> lists the room and all rooms below it, so that a test can link only these.
function(malus_add_module name)
  cmake_parse_arguments(ARG "" "" "DEPENDS;PRIVATE" ${ARGN})
  file(GLOB sources CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/${name}/*.cpp)
  set(rooms)
  if(sources)
    set(rooms malus_${name})
  endif()
  foreach(dependency IN LISTS ARG_DEPENDS)
    get_property(below GLOBAL PROPERTY MALUS_ROOMS_${dependency})
    list(APPEND rooms ${below})
  endforeach()
  list(REMOVE_DUPLICATES rooms)
  set_property(GLOBAL PROPERTY MALUS_ROOMS_${name} ${rooms})
  if(NOT sources)
    return()
  endif()
  add_library(malus_${name} OBJECT ${sources})
  target_include_directories(malus_${name} PUBLIC ${PROJECT_SOURCE_DIR}/cpp ${PROJECT_BINARY_DIR}/generated)
  target_link_libraries(malus_${name} PUBLIC Eigen3::Eigen Threads::Threads
                                      PRIVATE malus_settings ${ARG_PRIVATE})
  set_property(GLOBAL APPEND PROPERTY MALUS_MODULES malus_${name})
endfunction()

# Links the libraries that the rooms use. CHOLMOD and its BLAS come before Ceres, which links another BLAS.
function(malus_link_libraries target)
  target_link_libraries(${target} PUBLIC Eigen3::Eigen Threads::Threads
                                  PRIVATE CHOLMOD::CHOLMOD Ceres::ceres ${OpenCV_LIBS} TBB::tbb TIFF::TIFF PNG::PNG
                                          JPEG::JPEG OpenSSL::Crypto re2::re2 tomlplusplus::tomlplusplus)
endfunction()

# Adds the objects of the given targets (rooms) to a target, with the libraries that the rooms use.
function(malus_link_rooms target)
  foreach(objects IN LISTS ARGN)
    target_sources(${target} PRIVATE $<TARGET_OBJECTS:${objects}>)
  endforeach()
  malus_link_libraries(${target})
endfunction()
