#pragma once

#include <opencv2/core/mat.hpp>

#include "malus/core/image.h"

namespace malus {

/// View of the image's memory as an OpenCV matrix, without a copy. Include only in .cpp files of rooms that use OpenCV.
template <class T>
cv::Mat as_mat(Image<T>& image) {
  return {image.height(), image.width(), CV_MAKETYPE(cv::DataType<T>::depth, image.channels()), image.data()};
}

/// The same for an image that OpenCV must not write to; cv::Mat cannot express const.
template <class T>
cv::Mat as_mat(const Image<T>& image) {
  return as_mat(const_cast<Image<T>&>(image));
}

}  // namespace malus
