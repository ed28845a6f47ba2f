// SPDX-License-Identifier: GPL-3.0-or-later
// How near the rendered force is to a full re-solve (docs/results/haptic-fidelity.md).
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <stdexcept>

#include "bench/figures.hpp"
#include "support/fidelity.hpp"

namespace sutured::bench {
namespace {

using testing::FidelityError;
using testing::FidelityMotion;
using testing::FidelityResult;

/// What DESIGN allows, % of the peak; 0: it names nothing.
struct Budget {
  double rms_pct = 1.0, max_pct = 3.0, torque_rms_pct = 2.0;
};

Budget budget_of(const std::string& motion) {
  if (motion == "tip") return {4.0, 0.0, 0.0};
  if (motion == "thread") return {1.0, 0.0, 0.0};
  return {};
}

double step_budget_n(const FidelityResult& result) {
  return std::max(0.02 * result.peak_force_n, 0.01);
}

std::optional<double> optional_budget(double value) {
  return value > 0.0 ? std::optional<double>(value) : std::nullopt;
}

/// A cell of the table, bold where it misses its budget.
std::string cell(double value, double budget, int digits) {
  char text[64];
  const bool missed = budget > 0.0 && value > budget;
  std::snprintf(text, sizeof text, missed ? "**%.*f**" : "%.*f", digits, value);
  return text;
}

void write_curves(const std::string& path, const FidelityResult& result) {
  std::ofstream file(path);
  file << "time_s";
  for (const char* what : {"truth", "model", "held", "linear"})
    for (const char* axis : {"x", "y", "z"}) file << ',' << what << "_f" << axis << "_n";
  file << '\n';
  for (const testing::FidelitySample& s : result.samples) {
    file << s.time_s;
    for (const simulation::Vec6* w : {&s.truth, &s.model, &s.held, &s.linear})
      for (int i = 0; i < 3; ++i) file << ',' << (*w)[i];
    file << '\n';
  }
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

}  // namespace

void measure_fidelity(Figures& figures) {
  for (const FidelityMotion& motion : testing::fidelity_motions()) {
    const FidelityResult result = testing::measure_fidelity(motion);
    const Budget budget = budget_of(motion.name);
    const std::string name = "fidelity." + motion.name;
    figures.add(name + ".rms_pct", result.model.rms_pct, "%", optional_budget(budget.rms_pct));
    figures.add(name + ".max_pct", result.model.max_pct, "%", optional_budget(budget.max_pct));
    figures.add(name + ".torque_rms_pct", result.model.torque_rms_pct, "%",
                optional_budget(budget.torque_rms_pct));
    figures.add(name + ".swap_step_n", result.swap_step_n, "N", step_budget_n(result));
  }
}

void study_fidelity(const std::string& folder) {
  std::string table =
      "| Motion | Peak N, N·mm | Model: RMS, max, torque RMS % | Held: RMS, max % | Linear in "
      "time: "
      "RMS, max % | Step at a swap, without blend, N | Rows, frozen |\n"
      "|---|---|---|---|---|---|---|\n";
  std::string totals =
      "| Motion | Scene at 250 Hz: RMS, max % | At 30 Hz: RMS, max % |\n|---|---|---|\n";
  char text[256];
  const auto add_row = [&](const std::string& title, const FidelityResult& r, const Budget& b) {
    std::snprintf(text, sizeof text, " | %.2f, %.2f | ", r.peak_force_n, 1e3 * r.peak_torque_nm);
    table += "| " + title + text + cell(r.model.rms_pct, b.rms_pct, 2) + ", " +
             cell(r.model.max_pct, b.max_pct, 2) + ", " +
             cell(r.model.torque_rms_pct, b.torque_rms_pct, 2);
    std::snprintf(text, sizeof text, " | %.0f, %.0f | %.1f, %.1f | ", r.held.rms_pct,
                  r.held.max_pct, r.linear.rms_pct, r.linear.max_pct);
    table += text + cell(r.swap_step_n, step_budget_n(r), 4);
    std::snprintf(text, sizeof text, ", %.4f | %d, %d |\n", r.swap_jump_n, r.rows_max,
                  r.frozen_rows_max);
    table += text;
  };
  for (const FidelityMotion& motion : testing::fidelity_motions()) {
    const FidelityResult result = testing::measure_fidelity(motion);
    add_row("`" + motion.name + "`: " + motion.title, result, budget_of(motion.name));
    if (motion.name == "two_hands")
      add_row("the same, models that know one hand",
              testing::measure_fidelity(motion, {.couple_tools = false}), {0.0, 0.0, 0.0});
    write_curves(folder + "/" + motion.name + ".csv", result);
    const FidelityError fast = testing::measure_total_error(motion, result, 250.0);
    const FidelityError slow = testing::measure_total_error(motion, result, 1000.0 / 33.0);
    std::snprintf(text, sizeof text, "| `%s` | %.2f, %.1f | %.1f, %.0f |\n", motion.name.c_str(),
                  fast.rms_pct, fast.max_pct, slow.rms_pct, slow.max_pct);
    totals += text;
  }
  std::printf("%s\n%s", table.c_str(), totals.c_str());
  std::ofstream file(folder + "/tables.md");
  file << table << '\n' << totals;
  if (!file.flush()) throw std::runtime_error("cannot write " + folder + "/tables.md");
}

}  // namespace sutured::bench
