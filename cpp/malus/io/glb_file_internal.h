#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "malus/core/camera.h"
#include "malus/core/context.h"
#include "malus/core/geometry.h"
#include "malus/core/image.h"
#include "malus/core/length_unit_internal.h"
#include "malus/core/pose.h"

namespace malus {

/// The photograph of a mesh: each vertex takes its color from its projection into this camera.
struct ProjectedTexture {
  const Image<std::uint8_t>& image;  ///< sRGB, 1 or 3 channels, covers the whole view
  const Pinhole& camera;
  const Pose& pose;
  int texel_px = 1;  ///< side of a texel in pixels of the camera; texels of the last column and row may reach beyond it
};

/// Writes a mesh with a texture as binary glTF 2.0, atomically: one file, in meters (`unit` is the mesh's), in the
/// mesh's own frame and therefore not turned to glTF's y up. Positions are 32-bit floats relative to the middle of the
/// bounding box, which is the node's translation, so that coordinates of a national grid lose no precision. UV = pixel
/// grid of the camera; the texture is a JPEG, the material rough and not metallic. A second node carries the camera, so
/// that viewers can show the photograph's view. `extras`: a JSON object with metadata of the file (asset.extras), or
/// empty. Throws an input error for a mesh without triangles or unless it has one normal per vertex, a resource error
/// when it cannot be written or would exceed 4 GB.
void write_glb(const std::filesystem::path& path, const TriangleMesh& mesh, const ProjectedTexture& texture,
               const LengthUnit& unit, const std::string& name, const Context& context = {},
               const std::string& extras = {});

}  // namespace malus
