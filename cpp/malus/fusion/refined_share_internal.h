#pragma once

namespace malus {

/// Refined share of the object below which practically none of the object counts as finer than the prior, and from
/// which on nearly all of it does.
inline constexpr double refined_nowhere = 0.05, refined_everywhere = 0.9;

}  // namespace malus
