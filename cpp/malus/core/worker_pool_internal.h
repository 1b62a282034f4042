#pragma once

#include <cstddef>
#include <functional>

namespace malus {

/// Calls work() on this thread and on up to `others` threads that wait for such calls, and returns when all of its
/// calls have returned. A thread that has not begun when this one's call returns no longer begins: work() takes from a
/// common supply, which is empty then. It must not throw. Calls may be nested and may come from any thread; after
/// fork() the child gets threads of its own.
///
/// A call within another's work shares its threads, and those that wait for others to return work for the calls within
/// them: parts of unequal length, each with loops of its own, keep all threads busy and take no more.
///
/// Starting a thread takes some 40 µs, which the short passes of an iterative solver would pay thousands of times.
void run_on_workers(std::size_t others, const std::function<void()>& work);

}  // namespace malus
