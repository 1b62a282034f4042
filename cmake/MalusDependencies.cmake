# Everything comes from Debian 12; the minimum versions are the ones that were tested.
find_package(Threads REQUIRED)
find_package(Eigen3 3.4 REQUIRED NO_MODULE)
find_package(TIFF REQUIRED)
find_package(OpenCV 4.5 REQUIRED COMPONENTS core imgproc imgcodecs calib3d video)
find_package(Ceres 2.1 REQUIRED)
find_package(CHOLMOD REQUIRED)
find_package(nlohmann_json 3.11 REQUIRED)
find_package(tomlplusplus 3.0 REQUIRED)
