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

/// Returns a picture of force over time as a self-contained SVG: the envelope of the
/// samples, axes in round numbers, marks with labels. Readable on light and dark pages.
[[nodiscard]] std::string force_plot_svg(const ForceTrace& trace, std::span<const PlotMark> marks,
                                         const std::string& title);

}  // namespace suture::cli
