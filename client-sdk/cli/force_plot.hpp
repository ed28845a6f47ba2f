// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <string>

#include "force_log.hpp"

namespace suture::cli {

/// Something worth a mark on the time axis.
struct PlotMark {
  double time_s = 0.0;
  std::string label;
};

/// One tool's force over time.
struct PlotCurve {
  std::string label;
  const ForceTrace* trace = nullptr;
};

/// Returns a picture of force over time as a self-contained SVG: the envelope of each curve's
/// samples, axes in round numbers, marks with labels; a legend where there are several curves.
/// Readable on light and dark pages.
[[nodiscard]] std::string force_plot_svg(std::span<const PlotCurve> curves,
                                         std::span<const PlotMark> marks, const std::string& title);

}  // namespace suture::cli
