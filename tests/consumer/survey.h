#pragma once

#include <malus/core/camera.h>
#include <malus/core/geometry.h>
#include <malus/core/image.h>
#include <malus/core/pose.h>

#include <vector>

// Data that the photogrammetry program has before it calls Malus: here of a simulated carved plate, in millimeters.

/// A camera and its pose.
struct View {
  malus::Pinhole camera;
  malus::Pose pose;  ///< cam_from_world
};

/// The view that was taken through the polarizer.
View polarized_view();
/// Its images, linear, 1 = white, at these angles of the polarizer.
std::vector<malus::Image<float>> polarized_images(const std::vector<double>& angles_deg);

/// Points of the plate in the world, each intersected from its marks in three photos.
malus::PointCloud intersected_points();

/// The truth: depth in the polarized view, and the normal there (camera frame, towards the camera).
double true_depth(double u, double v);
Eigen::Vector3d true_normal(double u, double v);
