// SPDX-License-Identifier: GPL-3.0-or-later
// Named figures: what `make bench` prints and writes to results.json.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace sutured::bench {

/// One measured figure. Where there is a budget, the figure is to stay at or below it.
struct Figure {
  std::string name;  ///< "step_ms.paper.p50"
  double value = 0.0;
  std::string unit;
  std::optional<double> budget;
};

/// The figures of one run, in order.
class Figures {
 public:
  /// Adds a figure and prints its line of the table.
  void add(std::string name, double value, std::string unit,
           std::optional<double> budget = std::nullopt);
  /// Prints the table's head.
  void begin() const;
  /// Writes a flat object of figures and of `facts` (machine, compiler, …). Throws
  /// std::runtime_error where the file cannot be written.
  void write(const std::string& path,
             const std::vector<std::pair<std::string, std::string>>& facts) const;
  [[nodiscard]] int missed() const { return missed_; }

 private:
  std::vector<Figure> figures_;
  int missed_ = 0;
};

/// Returns the `fraction` quantile of `values`, the nearest one above; they get sorted.
/// At least one value.
[[nodiscard]] double quantile(std::vector<double>& values, double fraction);

/// Returns the processor time that `work()` takes on this thread, in microseconds: what others
/// do with a shared machine meanwhile does not count.
template <typename Work>
[[nodiscard]] double time_us(Work&& work);

/// Returns the time that `work()` takes by the clock, in microseconds: for work of two threads.
template <typename Work>
[[nodiscard]] double wall_time_us(Work&& work) {
  const auto begun = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begun)
      .count();
}

// Each measures its part of the budgets and adds its figures.
void measure_step(Figures& figures);
void measure_checkpoint(Figures& figures);
void measure_closure(Figures& figures);
void measure_tissue(Figures& figures);
void measure_tick(Figures& figures);
void measure_fidelity(Figures& figures);
void measure_wakeup(Figures& figures);
void measure_roundtrip(Figures& figures);
void measure_with_checkpoints(Figures& figures);
void measure_security(Figures& figures);
void measure_mesh(Figures& figures);
void measure_viewers(Figures& figures);

/// Prints what `model = "outside"` and `"path"` of a thread give on three meshes.
void study_thread_model();

/// Prints how near rendered forces are to a full re-solve, and writes tables and
/// curves to `folder`. Throws where it cannot.
void study_fidelity(const std::string& folder);

/// Answers every pose of a session with a force, without any thought, until it is killed.
/// `security`: folder of keys, or off.
[[noreturn]] void echo(std::uint32_t domain, const std::string& session,
                       const std::string& security);
/// Serves the main scene until it is killed, and writes large meshes beside between SIGUSR1 and
/// SIGUSR2.
[[noreturn]] void serve_with_mesh(std::uint32_t domain, const std::string& session);
/// Takes meshes until SIGTERM, and prints how many of the large ones came.
void view_mesh(std::uint32_t domain, const std::string& session);
/// Is fifty web viewers, between SIGUSR1 and SIGUSR2, until SIGTERM, and prints how many frames
/// came.
void watch_web(std::uint16_t port);

/// Returns the processor time that this thread has used.
[[nodiscard]] std::int64_t thread_time_ns();

template <typename Work>
double time_us(Work&& work) {
  const std::int64_t begun_ns = thread_time_ns();
  work();
  return 1e-3 * static_cast<double>(thread_time_ns() - begun_ns);
}

}  // namespace sutured::bench
