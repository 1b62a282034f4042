#include "interruptible.h"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <thread>

#include "malus/core/fields.h"

namespace malus::python {
namespace {

/// Events on their way from the computing threads to Python.
class Mailbox {
 public:
  using Event = std::function<void()>;

  void post(Event event) {
    const std::lock_guard lock(mutex_);
    events_.push_back(std::move(event));
    changed_.notify_one();
  }
  void close() {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    changed_.notify_one();
  }
  /// Waits up to 100 ms for events; returns false once the mailbox is closed and empty.
  bool take(std::deque<Event>& events) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, std::chrono::milliseconds(100), [&] { return closed_ || !events_.empty(); });
    events.swap(events_);
    return !(closed_ && events.empty());
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Event> events_;
  bool closed_ = false;
};

}  // namespace

void run_interruptible(int threads, const py::object& on_progress, const py::object& on_log,
                       const std::function<void(const Context&)>& compute) {
  Mailbox mailbox;
  std::atomic<bool> cancel{false};
  Context context;
  context.threads = threads;
  context.validate();
  context.cancel = &cancel;
  if (!on_progress.is_none()) {
    context.on_progress = [&](const Progress& p) {
      mailbox.post([&on_progress, p] { on_progress(p.step, p.fraction, p.message); });
    };
  }
  if (!on_log.is_none()) {
    context.on_log = [&](LogLevel level, const std::string& message) {
      mailbox.post([&on_log, level, message] { on_log(enum_name(level), message); });
    };
  }

  std::exception_ptr computation_error, python_error;
  std::thread worker([&] {
    try {
      compute(context);
    } catch (...) {
      computation_error = std::current_exception();
    }
    mailbox.close();
  });

  for (bool open = true; open;) {
    std::deque<Mailbox::Event> events;
    {
      const py::gil_scoped_release release;
      open = mailbox.take(events);
    }
    if (python_error) continue;  // Already stopping: only wait for the worker.
    try {
      for (const auto& event : events) event();
      if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    } catch (...) {
      python_error = std::current_exception();
      cancel.store(true);
    }
  }
  {
    const py::gil_scoped_release release;
    worker.join();
  }
  if (python_error) std::rethrow_exception(python_error);
  if (computation_error) std::rethrow_exception(computation_error);
}

}  // namespace malus::python
