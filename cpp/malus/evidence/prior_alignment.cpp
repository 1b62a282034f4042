#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <sstream>
#include <utility>

#include "malus/core/degrees_internal.h"
#include "malus/core/digits_internal.h"
#include "malus/core/even_choice_internal.h"
#include "malus/core/median_internal.h"
#include "malus/core/opencv_threads_internal.h"
#include "malus/evidence/alignment_place_internal.h"
#include "malus/evidence/mask_coverage_internal.h"
#include "malus/evidence/other_inputs_internal.h"
#include "malus/evidence/outline_place_internal.h"
#include "malus/evidence/prior_alignment_internal.h"
#include "malus/evidence/reduced_view_internal.h"
#include "malus/polarization/fresnel.h"
#include "malus/polarization/ray_frame.h"

namespace malus {
namespace {

using Kind = AlignmentProblem::Kind;

/// A prior that covers a smaller share of the object does not lie on it.
constexpr double hardly_covered = 0.02;
/// A prior that covers a smaller share of the object is not compared with the images.
constexpr double too_little_covered = 0.1;
/// Coverage by a moved cloud from which that move is a likely explanation.
constexpr double moved_covers = 0.3;
constexpr std::size_t ideas_tried = 6;
/// A cloud with fewer points per pixel of the reduced view leaves gaps there wherever it lies; that it lies on the
/// object is seen by its having points in this share of the object's large cells.
constexpr double sparse_points = 0.3, sparse_covers = 0.4;
constexpr int large_cells_per_side = 6;
/// Squared correlations below which colors or phases of prior and images are unrelated, and the depth step across the
/// mask's outline, in pixels of the reduced view, below which the prior has no outline there.
constexpr double common_color = 0.05, common_phase = 0.12, common_step = 1.5;
/// An object mirrors its surroundings if its degree of polarization exceeds that of a matte one with the prior's slopes
/// by `mirrors_times`. Rendered coins of lacquer and black glass have 8 to 26 times, matte, glazed and painted objects
/// 0.5 to 8.
constexpr double mirrors_times = 6, least_degree = 0.002;
/// Least that a variant of the input must explain, and how many times more than the input as given.
constexpr double least_explained = 0.1, explains_times = 3;

std::string rounded(double value, int decimals) {
  std::ostringstream text;
  text.setf(std::ios::fixed);
  text.precision(decimals);
  text << value;
  return text.str();
}

void take(const AlignmentPlace& place, PriorAlignment& alignment) {
  alignment.color = place.evidence[Kind::color];
  alignment.phase = place.evidence[Kind::phase];
  alignment.edges = place.evidence[Kind::edges];
  alignment.object_px = place.extent_px;
  alignment.right_px = place.place.du;
  alignment.down_px = place.place.dv;
  alignment.clockwise_deg = to_degrees(place.place.turn_rad);
  alignment.scale = std::exp(place.place.log_scale);
  alignment.shift_sigma_px = std::hypot(place.sigma.du, place.sigma.dv);
  alignment.turn_sigma_deg = to_degrees(place.sigma.turn_rad);
  alignment.scale_sigma = place.sigma.log_scale;
  alignment.gain_sigmas = place.gain_sigmas;
  alignment.detectable_shift_px = place.detectable.shift_px;
  alignment.detectable_turn_deg = to_degrees(place.detectable.turn_rad);
  alignment.detectable_scale = place.detectable.log_scale;
}

std::string joined(const std::vector<std::string>& parts, const char* last) {
  std::string text;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const char* const joint = i == 0 ? "" : i + 1 == parts.size() ? last : ", ";
    text += joint + parts[i];
  }
  return text;
}

/// Which offsets the check would detect here: "a shift from 5 px and a turn from 1.5° on would be noticed, but not
/// another size".
std::string detectable_in_words(const PriorAlignment& found) {
  std::vector<std::string> detectable, undetectable;
  const auto add = [&](const char* what, double from, const std::string& from_in_words) {
    if (from > 0)
      detectable.push_back(what + (" from " + from_in_words));
    else
      undetectable.emplace_back(what);
  };
  add("a shift", found.detectable_shift_px, rounded(found.detectable_shift_px, 0) + " px");
  add("a turn", found.detectable_turn_deg, rounded(found.detectable_turn_deg, 1) + "°");
  add("another size", found.detectable_scale, rounded(100 * found.detectable_scale, 1) + " %");
  if (detectable.empty()) return "an offset of some percent would not be noticed";
  return joined(detectable, " and ") + " on would be noticed" +
         (undetectable.empty() ? "" : ", but not " + joined(undetectable, " or "));
}

/// The parts of an offset beyond these limits: "5.1 mm (17 px) too far left", "turned by 1.2° clockwise", "5 % too
/// large".
std::string offset_in_words(const PriorAlignment& found, const Tolerance& limits, const std::string& unit) {
  std::vector<std::string> parts;
  const double shift = std::hypot(found.right_px, found.down_px);
  const auto along = [&](double px, const char* forwards, const char* backwards) {
    if (std::abs(px) < 0.3 * shift) return;
    parts.push_back(with_digits(std::abs(px) * found.gsd, 2) + " " + unit + " (" + rounded(std::abs(px), 0) + " px) " +
                    (px > 0 ? backwards : forwards));
  };
  if (shift > limits.shift * found.object_px) {
    along(found.right_px, "too far right", "too far left");
    along(found.down_px, "too low", "too high");
  }
  if (std::abs(found.clockwise_deg) > limits.turn_deg) {
    parts.push_back("turned by " + rounded(std::abs(found.clockwise_deg), 1) + "° " +
                    (found.clockwise_deg > 0 ? "counter-clockwise" : "clockwise"));
  }
  if (std::abs(found.scale - 1) > limits.scale) {
    parts.push_back(rounded(100 * std::abs(1 / found.scale - 1), 0) + " % too " +
                    (found.scale > 1 ? "small" : "large"));
  }
  return joined(parts, " and ");
}

void say(PriorAlignment& found, Severity severity, std::string message, std::string suggestion) {
  found.finding.check = Check::prior;
  found.finding.severity = severity;
  found.finding.message = std::move(message);
  found.finding.suggestion = std::move(suggestion);
}

void add_figures(PriorAlignment& found) {
  auto& figures = found.finding.figures;
  figures = {{"points_in_view", found.points_in_view},
             {"points_on_object", found.points_on_object},
             {"object_covered", found.object_covered},
             {"outline_step_gsd", found.outline_step_gsd},
             {"right_px", found.right_px},
             {"down_px", found.down_px},
             {"clockwise_deg", found.clockwise_deg},
             {"scale", found.scale},
             {"shift_sigma_px", found.shift_sigma_px},
             {"turn_sigma_deg", found.turn_sigma_deg},
             {"scale_sigma", found.scale_sigma},
             {"gain_sigmas", found.gain_sigmas},
             {"detectable_shift_px", found.detectable_shift_px},
             {"detectable_turn_deg", found.detectable_turn_deg},
             {"detectable_scale", found.detectable_scale}};
  const auto add = [&](const std::string& name, const AlignmentEvidence& cue) {
    if (!cue.available) return;
    figures.emplace_back(name + "_as_given", cue.as_given);
    figures.emplace_back(name + "_at_best", cue.at_best);
    figures.emplace_back(name + "_unrelated", cue.unrelated);
    figures.emplace_back(name + "_signal_sigmas", cue.signal_sigmas);
    figures.emplace_back(name + "_gain_sigmas", cue.gain_sigmas);
  };
  figures.emplace_back("outline_as_given", found.outline_as_given);
  figures.emplace_back("outline_at_best", found.outline_at_best);
  figures.emplace_back("outline_gain_sigmas", found.outline_gain_sigmas);
  add("color", found.color);
  add("phase", found.phase);
  add("edges", found.edges);
}

void judge_place(const AlignmentPlace& place, const std::string& unit, PriorAlignment& found) {
  if (!place.is_informative()) {
    say(found, Severity::note,
        "whether the prior lies where the images show the object could not be checked: it has neither colors nor "
        "relief "
        "that the images show, too",
        "");
    return;
  }
  if (place.is_offset(found.object_covered)) {
    say(found, Severity::warning,
        "the prior does not lie where the images show the object: it seems " +
            offset_in_words(found, place.tolerance(), unit),
        "were the images taken from where [camera] says, with this lens, and is the prior of the same object in the "
        "same "
        "frame?");
    return;
  }
  say(found, Severity::note,
      "the prior lies where the images show the object: best fit " +
          with_digits(std::hypot(found.right_px, found.down_px), 2) + " px away; " + detectable_in_words(found),
      "");
}

/// The variant of the input that explains most, if it explains much more than the input as given.
template <class Idea, class PlaceOf>
const Idea* best_idea(const std::vector<Idea>& ideas, const AlignmentPlace& given, const PlaceOf& place_of) {
  const Idea* best = nullptr;
  double most = std::max(least_explained, explains_times * given.explained());
  if (most >= AlignmentPlace::most_explained) return nullptr;
  for (const Idea& idea : ideas) {
    const AlignmentPlace place = place_of(idea);
    if (!place.is_informative() || !(place.explained() > most)) continue;
    most = place.explained();
    best = &idea;
  }
  return best;
}

/// Views at the few sizes that are needed, each made once.
template <class View>
class Views {
 public:
  explicit Views(std::function<View(int factor)> make) : make_(std::move(make)) {}

  const View& at(int factor) {
    const auto found = views_.find(factor);
    return found != views_.end() ? found->second : views_.emplace(factor, make_(factor)).first->second;
  }

 private:
  std::function<View(int factor)> make_;
  std::map<int, View> views_;
};

Views<SceneView> views_of(const AlignmentScene& scene, const Context& context) {
  return Views<SceneView>([&](int factor) { return scene_view(scene, factor, context); });
}

/// Compares a prior with the images as given and with turned or mirrored images.
AlignmentPlace compare(Views<PriorView>& priors, const AlignmentScene& scene, Views<SceneView>& scenes,
                       PriorAlignment& found, const Context& context) {
  const Size size = scene.state.size();
  const auto problem_at = [&](int factor) { return AlignmentProblem(priors.at(factor), scenes.at(factor)); };
  const AlignmentPlace place = find_place(problem_at, size, false, context);
  take(place, found);
  if (!place.usable) {
    say(found, Severity::note,
        "whether the prior lies where the images show the object could not be checked: prior and object are too small "
        "in the image",
        "");
    return place;
  }
  const std::vector<ImageTurn> turns = image_turns(size);
  const ImageTurn* const turn = best_idea(turns, place, [&](const ImageTurn& idea) {
    const auto turned_problem_at = [&](int factor) {
      return AlignmentProblem(priors.at(factor), undone(scenes.at(factor), idea));
    };
    return find_place(turned_problem_at, size, true, context);
  });
  if (turn != nullptr) {
    found.instead = turn->what;
    say(found, Severity::warning, turn->what + ": only then does the prior fit them", turn->remedy);
  } else {
    judge_place(place, scene.unit, found);
  }
  return place;
}

/// Tries other units, axes and poses of a cloud that does not fit as given.
void try_other_clouds(const PointCloud& cloud, const Pose& pose, const AlignmentScene& scene,
                      const CoverageCounter& coverage_of, Views<SceneView>& scenes, const AlignmentPlace& place,
                      PriorAlignment& found, const Context& context) {
  auto ideas = moved_clouds(cloud, pose, coverage_of, scene.unit, ideas_tried);
  std::erase_if(ideas, [](const MovedCloud& idea) { return idea.coverage.covered < moved_covers; });
  const MovedCloud* best = best_idea(ideas, place, [&](const MovedCloud& idea) {
    const auto problem_at = [&](int factor) {
      const SceneView& view = scenes.at(factor);
      return AlignmentProblem(prior_view(cloud, view.camera, idea.cam_from_cloud), view);
    };
    return find_place(problem_at, scene.state.size(), true, context);
  });
  // If nothing can be compared, it suffices that the given cloud misses the object and a moved one covers it.
  if (best == nullptr && found.object_covered < hardly_covered && !ideas.empty()) best = &ideas.front();
  if (best == nullptr) return;
  found.instead = best->what;
  say(found, found.object_covered < hardly_covered ? Severity::error : Severity::warning,
      best->what + ": only then does it fit the images", best->remedy);
}

/// Number of the cloud's points on the object, if these are too few to cover it but lie all over it; else 0.
double sparse_points_on_object(const PointCloud& cloud, const Eigen::Affine3d& given, const CloudCoverage& coverage,
                               const SceneView& view, const AlignmentScene& scene) {
  const double points = coverage.on_object * static_cast<double>(cloud.points.size());
  if (points >= sparse_points * static_cast<double>(count_of_set(view.object))) return 0;
  const CoverageCounter coverage_of(scene.camera, scene.object, large_cells_per_side);
  return coverage_of(cloud, given).covered >= sparse_covers ? points : 0;
}

/// Compares the prior's outline with the mask's, if the prior includes the object's surroundings.
void judge_outline(const PriorView& prior, const SceneView& view, const AlignmentScene& scene,
                   const MaskCoverage& covered, PriorAlignment& found) {
  if (covered.object < PriorAlignment::poorly_covered || !covered.has_surroundings()) return;
  const OutlinePlace outline = find_outline(prior, view);
  found.outline_as_given = outline.as_given;
  found.outline_at_best = outline.at_best;
  found.outline_gain_sigmas = outline.gain_sigmas;
  // Colors and phases are more reliable: the edges of a right prior may lie some percent beside the object's.
  if (found.color.informative || found.phase.informative || !outline.is_offset()) return;
  if (!found.instead.empty() || found.finding.severity != Severity::note) return;
  found.object_px = outline.extent * view.factor;
  found.right_px = outline.place.du * view.factor;
  found.down_px = outline.place.dv * view.factor;
  found.clockwise_deg = 0;
  found.scale = std::exp(outline.place.log_scale);
  say(found, Severity::warning,
      "the prior's outline does not lie on the mask's: against the mask, the prior seems " +
          offset_in_words(found, outline.half_step(), scene.unit),
      "are mask and [camera] those of these images, and is the prior in the same frame?");
}

/// Whether the object's brightness comes from mirrored surroundings, to which the colors of a cloud are unrelated.
bool mirrors_surroundings(const PriorView& prior, const SceneView& scene) {
  constexpr double usual_index = 1.5;
  std::vector<double> ratios;
  for_each_pixel(scene.object.size(), [&](int u, int v) {
    if (scene.object(u, v) == 0 || prior.seen(u, v) == 0 || !(scene.variance(u, v) > 0)) return;
    const Eigen::Vector3d normal(prior.normals(u, v, 0), prior.normals(u, v, 1), prior.normals(u, v, 2));
    const double tan2 = ray_frame(scene.camera.ray(u, v)).slopes(normal).tan2();
    if (!std::isfinite(tan2)) return;
    const double matt = diffuse_degree(std::atan(std::sqrt(tan2)), usual_index);
    ratios.push_back(std::hypot(scene.s1(u, v), scene.s2(u, v)) / (matt + least_degree));
  });
  return median_in_place(ratios) > mirrors_times;
}

/// Colors of the same object correlate with its brightness even where reflections differ, except for black lacquer. If
/// outline or slopes agree, as for two similar coins or tablets, unrelated colors only give a caution: the light may
/// have differed, and an object without markings shows nothing but the light.
void judge_relation(const PriorView& prior, const SceneView& view, const MaskCoverage& covered, PriorAlignment& found) {
  if (!found.instead.empty() || found.finding.severity != Severity::note ||
      covered.object < PriorAlignment::poorly_covered || !found.color.available)
    return;
  if (found.color.informative || found.color.as_given > common_color) return;
  const bool fits_otherwise =
      found.phase.informative || found.phase.as_given > common_phase || covered.outline_step > common_step;
  if (!fits_otherwise) {
    say(found, Severity::warning,
        "the images show nothing of what the prior shows: neither its colors nor its slopes nor its outline",
        "are they images of this object, in the order of their angles, and the prior's frame that of [camera]?");
  } else if (!mirrors_surroundings(prior, view)) {
    say(found, Severity::caution,
        "the cloud's colors have nothing in common with the brightness of the images, though outline or slopes have",
        "are they of the same object, and not of one that is like it? Other light on an object without markings does "
        "this, too");
  }
}

void judge_coverage(const MaskCoverage& covered, const std::string& what, PriorAlignment& found) {
  if (!found.instead.empty()) return;
  const std::string share = rounded(100 * covered.object, covered.object < 0.01 ? 1 : 0);
  if (covered.is_mask_inverted()) {
    found.instead = "the mask is inverted";
    say(found, covered.object < hardly_covered ? Severity::error : Severity::warning,
        covered.is_object_behind()
            ? "what is white in the mask reaches the border of the image and lies behind what is black"
            : "the " + what + " covers " + share + " % of what is white in the mask, and " +
                  rounded(100 * covered.beside, 0) + " % of what is black",
        "is the mask inverted? White is expected where the object is");
  } else if (covered.object < hardly_covered && !covered.has_surroundings()) {
    say(found, Severity::error,
        "the " + what + " does not lie on the object: " + rounded(100 * found.points_in_view, 1) +
            " % of it is in the camera's view, and it covers " + share + " % of the object",
        "expected prior and camera in one frame and one unit, and the mask of these images (white = object)");
  } else if (covered.object < too_little_covered && covered.has_surroundings()) {
    say(found, Severity::note,
        "whether the prior lies where the images show the object could not be checked: the " + what + " covers only " +
            share + " % of the object, though what is around it",
        "");
  } else if (covered.object < PriorAlignment::poorly_covered && !covered.has_surroundings() &&
             found.finding.severity == Severity::note) {
    say(found, Severity::warning, "the " + what + " covers only " + share + " % of the object",
        "is the mask right (white = object), and are prior and camera in one frame and one unit?");
  }
}

/// Share of the object's pixels that have a depth.
double share_with_depth(const Image<float>& depth, const Mask& object) {
  return mean_over(object, [&](int u, int v) { return std::isfinite(depth(u, v)) && depth(u, v) > 0; });
}

}  // namespace

std::string why_cloud_misses(const PointCloud& cloud, const Pose& pose, const Pinhole& camera, const Mask& object,
                             const std::string& unit) {
  const CoverageCounter coverage_of(camera, object);
  if (coverage_of(cloud, affine_of(pose)).covered >= too_little_covered) return "";
  const auto ideas = moved_clouds(cloud, pose, coverage_of, unit, 1);
  if (ideas.empty() || ideas.front().coverage.covered < moved_covers) return "";
  return ideas.front().what + ": only then does it fall there; " + ideas.front().remedy;
}

PriorAlignment check_alignment(const PointCloud& cloud, const Pose& pose, const AlignmentScene& scene,
                               const Context& context) {
  const OpenCvThreads threads(context.threads);
  PriorAlignment found;
  const Eigen::Affine3d given = affine_of(pose);
  const CoverageCounter coverage_of(scene.camera, scene.object);
  const CloudCoverage coverage = coverage_of(cloud, given);
  found.points_in_view = coverage.in_view;
  found.points_on_object = coverage.on_object;
  Views<SceneView> scenes = views_of(scene, context);
  Views<PriorView> priors([&](int factor) { return prior_view(cloud, reduced_camera(scene.camera, factor), given); });
  const int factor = coarse_factor(scene.state.size());
  MaskCoverage covered = mask_coverage(priors.at(factor), scenes.at(factor));
  if (std::isnan(covered.object)) covered.object = coverage.covered;
  found.object_covered = covered.object;
  found.outline_step_gsd = covered.outline_step * factor;
  found.gsd = priors.at(factor).median_depth / scene.camera.focal();
  AlignmentPlace place;
  if (covered.object >= too_little_covered) place = compare(priors, scene, scenes, found, context);
  const double sparse = covered.object < PriorAlignment::poorly_covered
                            ? sparse_points_on_object(cloud, given, coverage, scenes.at(factor), scene)
                            : 0;
  // A cloud on the object that cannot be compared, being too sparse, is no worse than a moved one that can.
  if (sparse == 0 && found.instead.empty() &&
      (covered.object < PriorAlignment::poorly_covered || (place.usable && !place.is_informative())))
    try_other_clouds(cloud, pose, scene, coverage_of, scenes, place, found, context);
  judge_outline(priors.at(factor), scenes.at(factor), scene, covered, found);
  judge_relation(priors.at(factor), scenes.at(factor), covered, found);
  if (sparse == 0 || covered.is_mask_inverted()) {
    judge_coverage(covered, "cloud", found);
  } else if (covered.object < too_little_covered) {
    say(found, Severity::note,
        "whether the prior lies where the images show the object could not be checked: the cloud has only " +
            rounded(sparse, 0) + " points on it",
        "");
  }
  add_figures(found);
  return found;
}

PriorAlignment check_alignment(const Image<float>& depth, const AlignmentScene& scene, const Context& context) {
  require_size(depth, scene.state.size(), "depth map of the prior");
  const OpenCvThreads threads(context.threads);
  PriorAlignment found;
  Views<SceneView> scenes = views_of(scene, context);
  Views<PriorView> priors([&](int factor) { return prior_view(depth, scene.camera, factor, context); });
  const int factor = coarse_factor(scene.state.size());
  MaskCoverage covered = mask_coverage(priors.at(factor), scenes.at(factor));
  if (std::isnan(covered.object)) covered.object = share_with_depth(depth, scene.object);
  found.object_covered = covered.object;
  found.outline_step_gsd = covered.outline_step * factor;
  found.gsd = priors.at(factor).median_depth / scene.camera.focal();
  if (covered.object >= too_little_covered) compare(priors, scene, scenes, found, context);
  judge_outline(priors.at(factor), scenes.at(factor), scene, covered, found);
  judge_coverage(covered, "prior", found);
  add_figures(found);
  return found;
}

}  // namespace malus
