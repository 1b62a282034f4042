#include <algorithm>
#include <opencv2/flann.hpp>

#include "malus/core/parallel_internal.h"
#include "malus/object/nearest_points_internal.h"

namespace malus {
namespace {

constexpr std::size_t places_in_a_block = 1 << 12;

/// OpenCV's matrices have no type for constant values; the tree only reads them.
cvflann::Matrix<double> rows_of(std::span<const Eigen::Vector3d> points) {
  return {const_cast<double*>(points.data()->data()), points.size(), 3};
}

}  // namespace

struct NearestPoints::Tree : cvflann::KDTreeSingleIndex<cvflann::L2<double>> {
  using KDTreeSingleIndex::KDTreeSingleIndex;
};

NearestPoints::NearestPoints(const std::vector<Eigen::Vector3d>& points)
    : tree_(std::make_unique<Tree>(rows_of(points), cvflann::KDTreeSingleIndexParams())) {
  tree_->buildIndex();
}

NearestPoints::~NearestPoints() = default;

void NearestPoints::for_each(std::span<const Eigen::Vector3d> places, int count, const Context& context,
                             const std::function<void(std::size_t, const NearPoints&)>& body) const {
  const std::size_t most = std::min(static_cast<std::size_t>(count), tree_->size());
  parallel_for(context, places.size(), places_in_a_block, [&](std::size_t begin, std::size_t end) {
    std::vector<int> which((end - begin) * most);
    std::vector<double> distances2(which.size());
    cvflann::Matrix<int> indices(which.data(), end - begin, most);
    cvflann::Matrix<double> squares(distances2.data(), end - begin, most);
    tree_->knnSearch(rows_of(places.subspan(begin, end - begin)), indices, squares, static_cast<int>(most),
                     cvflann::SearchParams(cvflann::FLANN_CHECKS_UNLIMITED));
    for (std::size_t i = begin; i < end; ++i) {
      body(i, {std::span(which).subspan((i - begin) * most, most),
               std::span(distances2).subspan((i - begin) * most, most)});
    }
  });
}

}  // namespace malus
