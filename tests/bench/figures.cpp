// SPDX-License-Identifier: GPL-3.0-or-later
#include "bench/figures.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>

namespace sutured::bench {

void Figures::begin() const {
  std::printf("%-42s %12s %-6s %10s  %s\n", "figure", "value", "unit", "budget", "met");
}

void Figures::add(std::string name, double value, std::string unit, std::optional<double> budget) {
  std::printf("%-42s %12.4g %-6s", name.c_str(), value, unit.c_str());
  if (budget) {
    const bool met = value <= *budget;
    missed_ += met ? 0 : 1;
    std::printf(" %10.4g  %s", *budget, met ? "yes" : "NO");
  }
  std::printf("\n");
  std::fflush(stdout);
  figures_.push_back({std::move(name), value, std::move(unit), budget});
}

void Figures::write(const std::string& path,
                    const std::vector<std::pair<std::string, std::string>>& facts) const {
  nlohmann::ordered_json results;
  for (const auto& [name, value] : facts) results[name] = value;
  for (const Figure& figure : figures_) results[figure.name] = figure.value;
  std::ofstream file(path);
  file << results.dump(2) << '\n';
  file.close();
  if (!file) throw std::runtime_error(path + ": cannot be written; choose another file with --out");
}

double quantile(std::vector<double>& values, double fraction) {
  std::sort(values.begin(), values.end());
  const auto rank =
      static_cast<std::size_t>(std::ceil(fraction * static_cast<double>(values.size())));
  return values[std::min(values.size(), std::max<std::size_t>(rank, 1)) - 1];
}

std::int64_t thread_time_ns() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec * 1'000'000'000 + now.tv_nsec;
}

}  // namespace sutured::bench
