# `cpack --config build/CPackConfig.cmake` makes a Debian package of malus-station and the C++ library.
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME malus)
set(CPACK_PACKAGE_VENDOR "The Malus authors")
set(CPACK_PACKAGE_CONTACT "The Malus authors <malus@example.org>")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "Surfaces of heritage objects: shape from polarization fused with stereo")
set(CPACK_RESOURCE_FILE_LICENSE ${PROJECT_SOURCE_DIR}/LICENSE)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
# dpkg-shlibdeps finds the libraries that malus-station needs. Programs that link the library also need their headers.
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SUGGESTS
    "libeigen3-dev, libtbb-dev, libsuitesparse-dev, libopenblas-dev, libceres-dev, libopencv-dev, libtiff-dev, libpng-dev, libjpeg-dev, libssl-dev, libre2-dev, libtomlplusplus-dev")
# The package leaves out the wheel's component "python".
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_ALL development)
set(CPACK_COMPONENTS_GROUPING ALL_COMPONENTS_IN_ONE)
include(CPack)
