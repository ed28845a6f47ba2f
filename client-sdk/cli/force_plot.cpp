// SPDX-License-Identifier: Apache-2.0
#include "force_plot.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include "client-sdk/xml_text.hpp"

namespace suture::cli {
namespace {

constexpr double kWidth = 960, kHeight = 360;
constexpr double kLabelWidth = 10;
constexpr double kLeft = 64, kRight = 16, kTop = 44, kBottom = 44;
// Told apart by most eyes, and from the red of the marks; repeated beyond six curves.
constexpr std::array<const char*, 6> kColours{"#2471a3", "#d68910", "#1e8449",
                                              "#7d3c98", "#566573", "#117a65"};

/// Returns the round number (1, 2 or 5 times a power of ten) that cuts `range` into at
/// most `most` parts.
double round_step(double range, int most) {
  const double rough = range / most;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (factor * power >= rough * (1.0 - 1e-9)) return factor * power;
  }
  return 10.0 * power;
}

template <class... Values>
void append(std::string& svg, const char* format, Values... values) {
  char line[512];
  std::snprintf(line, sizeof line, format, values...);
  svg += line;
}

}  // namespace

std::string force_plot_svg(std::span<const PlotCurve> curves, std::span<const PlotMark> marks,
                           const std::string& title) {
  double begin_s = 0.0, end_s = 1.0, peak_n = 0.0;
  bool some = false;
  for (const PlotCurve& curve : curves) {
    const ForceTrace& trace = *curve.trace;
    if (trace.size() == 0) continue;
    const double first_s = trace.begin()->time_s, last_s = (trace.end() - 1)->time_s;
    begin_s = some ? std::min(begin_s, first_s) : first_s;
    end_s = some ? std::max(end_s, last_s) : last_s;
    for (const ForceTrace::Column& column : trace) peak_n = std::max(peak_n, column.max_n);
    some = true;
  }
  end_s = std::max(end_s, begin_s + 1e-3);
  const double force_step = round_step(std::max(peak_n, 1e-3), 5);
  const double top_n = std::max(std::ceil(peak_n / force_step), 1.0) * force_step;
  const double time_step = round_step(end_s - begin_s, 10);
  const auto x = [&](double t) {
    return kLeft + (t - begin_s) / (end_s - begin_s) * (kWidth - kLeft - kRight);
  };
  const auto y = [&](double f) {
    return kHeight - kBottom - f / top_n * (kHeight - kTop - kBottom);
  };

  std::string svg;
  append(svg,
         "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %g %g\" "
         "font-family=\"sans-serif\" font-size=\"12\">\n",
         kWidth, kHeight);
  append(svg, "<rect width=\"%g\" height=\"%g\" fill=\"#ffffff\"/>\n", kWidth, kHeight);
  svg += "<text x=\"" + std::to_string(static_cast<int>(kLeft)) +
         "\" y=\"22\" font-size=\"15\" fill=\"#222\">" + xml_escaped(title) + "</text>\n";
  for (double f = 0.0; f <= top_n * (1.0 + 1e-9); f += force_step) {
    append(svg, "<path d=\"M%g %.2fH%g\" stroke=\"#ddd\"/>", kLeft, y(f), kWidth - kRight);
    append(svg, "<text x=\"%g\" y=\"%.2f\" text-anchor=\"end\" fill=\"#444\">%g</text>\n",
           kLeft - 8, y(f) + 4, std::abs(f) < 1e-12 ? 0.0 : f);
  }
  for (double t = std::ceil(begin_s / time_step) * time_step; t <= end_s + 1e-9; t += time_step) {
    append(svg, "<path d=\"M%.2f %gv5\" stroke=\"#444\"/>", x(t), kHeight - kBottom);
    append(svg, "<text x=\"%.2f\" y=\"%g\" text-anchor=\"middle\" fill=\"#444\">%g</text>\n", x(t),
           kHeight - kBottom + 18, std::abs(t) < 1e-9 ? 0.0 : t);
  }
  append(svg, "<text x=\"%g\" y=\"%g\" text-anchor=\"middle\" fill=\"#444\">time (s)</text>\n",
         (kLeft + kWidth - kRight) / 2, kHeight - 6);
  append(svg,
         "<text transform=\"translate(16 %g) rotate(-90)\" text-anchor=\"middle\" "
         "fill=\"#444\">force (N)</text>\n",
         (kTop + kHeight - kBottom) / 2);
  double labelled_to = 0.0;
  for (const PlotMark& mark : marks) {
    if (mark.time_s < begin_s || mark.time_s > end_s) continue;
    append(svg, "<path d=\"M%.2f %gV%g\" stroke=\"#c0392b\" stroke-dasharray=\"3 3\"/>",
           x(mark.time_s), kTop, kHeight - kBottom);
    if (x(mark.time_s) < labelled_to) continue;  // it would lie over the last one
    labelled_to = x(mark.time_s) + kLabelWidth;
    append(svg, "<text transform=\"translate(%.2f %g) rotate(-90)\" text-anchor=\"end\" ",
           x(mark.time_s) - 3, kTop + 2);
    svg += "font-size=\"10\" fill=\"#c0392b\">" + xml_escaped(mark.label) + "</text>\n";
  }
  // The envelope: up along the largest values, back along the smallest.
  for (std::size_t i = 0; i < curves.size(); ++i) {
    const ForceTrace& trace = *curves[i].trace;
    if (trace.size() == 0) continue;
    const char* colour = kColours[i % kColours.size()];
    append(svg, "<path fill=\"%s\" fill-opacity=\"0.35\" stroke=\"%s\" stroke-width=\"1\" d=\"M",
           colour, colour);
    for (const ForceTrace::Column& column : trace) {
      append(svg, "%.2f %.2f ", x(column.time_s), y(column.max_n));
    }
    for (const ForceTrace::Column* column = trace.end(); column != trace.begin();) {
      --column;
      append(svg, "%.2f %.2f ", x(column->time_s), y(column->min_n));
    }
    svg += "Z\"/>\n";
  }
  double legend_x = kLeft;
  for (std::size_t i = 0; curves.size() > 1 && i < curves.size(); ++i) {
    append(svg, "<path d=\"M%g 34h14\" stroke=\"%s\" stroke-width=\"3\"/>", legend_x,
           kColours[i % kColours.size()]);
    append(svg, "<text x=\"%g\" y=\"38\" fill=\"#444\">", legend_x + 18);
    svg += xml_escaped(curves[i].label) + "</text>\n";
    legend_x += 34.0 + 7.0 * static_cast<double>(curves[i].label.size());
  }
  append(svg, "<path d=\"M%g %gV%gH%g\" fill=\"none\" stroke=\"#444\"/>\n</svg>\n", kLeft, kTop,
         kHeight - kBottom, kWidth - kRight);
  return svg;
}

}  // namespace suture::cli
