#pragma once

namespace malus {

/// Share of the object below which next to nothing of it is finer than the prior, and from which on nearly all is.
inline constexpr double refined_nowhere = 0.05, refined_everywhere = 0.9;

}  // namespace malus
