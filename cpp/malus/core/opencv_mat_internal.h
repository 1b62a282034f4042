#pragma once

#include <opencv2/core/mat.hpp>

#include "malus/core/image.h"

namespace malus {

/// The image's own memory for OpenCV. For sources only, of rooms that use OpenCV.
template <class T>
cv::Mat as_mat(Image<T>& image) {
  return {image.height(), image.width(), CV_MAKETYPE(cv::DataType<T>::depth, image.channels()), image.data()};
}

/// The same of an image that OpenCV must only read, which its matrices cannot say.
template <class T>
cv::Mat as_mat(const Image<T>& image) {
  return as_mat(const_cast<Image<T>&>(image));
}

}  // namespace malus
