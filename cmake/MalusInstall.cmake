# The CMake package: find_package(malus) gives malus::malus. Everything here is in the component
# "development"; a wheel contains the component "python" only.
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

set(config_dir ${CMAKE_INSTALL_LIBDIR}/cmake/malus)
install(TARGETS malus EXPORT malus-targets
        ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT development
        LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT development
        RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT development
        INCLUDES DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
if(TARGET malus-station)
  install(TARGETS malus-station RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT development)
  install(FILES cpp/app/completion/malus-station DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions
          COMPONENT development)
  install(FILES cpp/app/completion/_malus-station DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/vendor-completions
          COMPONENT development)
endif()
if(TARGET malus-station-manual)
  install(FILES ${PROJECT_BINARY_DIR}/malus-station.1.gz DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT development)
endif()
install(DIRECTORY cpp/malus ${PROJECT_BINARY_DIR}/generated/malus DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}
        COMPONENT development FILES_MATCHING PATTERN "*.h" PATTERN "*_internal.h" EXCLUDE)
install(EXPORT malus-targets NAMESPACE malus:: DESTINATION ${config_dir} COMPONENT development)
configure_package_config_file(cmake/malus-config.cmake.in ${PROJECT_BINARY_DIR}/malus-config.cmake
                              INSTALL_DESTINATION ${config_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/malus-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/malus-config.cmake ${PROJECT_BINARY_DIR}/malus-config-version.cmake
              cmake/FindCHOLMOD.cmake cmake/Findre2.cmake DESTINATION ${config_dir} COMPONENT development)
