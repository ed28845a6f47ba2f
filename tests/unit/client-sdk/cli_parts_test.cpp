// SPDX-License-Identifier: GPL-3.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <string>

#include "force_log.hpp"
#include "force_plot.hpp"
#include "support/temporary_folder.hpp"

namespace suture::cli {
namespace {

using ::testing::HasSubstr;

TEST(ForceTrace, KeepsEveryPeakHoweverLongItGets) {
  ForceTrace trace;
  constexpr int kSamples = 1'000'000;
  for (int i = 0; i < kSamples; ++i) {
    trace.add(1e-3 * i, i == 123'456 ? 9.0 : i == 777'777 ? -1.0 : 1.0);
  }
  EXPECT_LE(trace.size(), 4096U);
  EXPECT_GE(trace.size(), 2048U);
  double highest = 0.0, lowest = 1.0;
  for (const ForceTrace::Column& column : trace) {
    if (column.max_n > highest) {
      highest = column.max_n;
      EXPECT_TRUE(highest == 1.0 || std::abs(column.time_s - 123.456) < 0.6) << column.time_s;
    }
    lowest = std::min(lowest, column.min_n);
  }
  EXPECT_EQ(highest, 9.0);
  EXPECT_EQ(lowest, -1.0);
  EXPECT_TRUE(std::is_sorted(trace.begin(), trace.end(),
                             [](const auto& a, const auto& b) { return a.time_s < b.time_s; }));
}

TEST(ForceLog, LeavesNothingBehindOfAPlayThatDidNotBegin) {
  const sutured::testing::TemporaryFolder folder;
  const std::array<std::string, 1> tools{"driver"};
  const std::string fresh = folder.path("fresh.csv");
  const std::string old = folder.write("old.csv", "of last time\n");
  {
    const ForceLog log(fresh, tools), other(old, tools);
    EXPECT_TRUE(std::filesystem::exists(fresh));  // it can be written
  }
  EXPECT_FALSE(std::filesystem::exists(fresh));
  EXPECT_EQ(sutured::testing::read_file(old), "of last time\n");
  for (const std::string& path : {fresh, old}) {
    ForceLog log(path, tools);
    log.begin();
  }
  for (const std::string& path : {fresh, old})
    EXPECT_THAT(sutured::testing::read_file(path), ::testing::StartsWith("time_s,tool,"));
}

TEST(ForcePlot, ShowsTitleAxesMarksAndCurve) {
  ForceTrace trace;
  for (int i = 0; i <= 100; ++i) trace.add(0.1 * i, 0.02 * i);
  const PlotMark mark{5.0, "puncture <wall>"};
  const PlotCurve curve{"driver", &trace};
  const std::string svg = force_plot_svg({&curve, 1}, {&mark, 1}, "a & b");
  EXPECT_THAT(svg, HasSubstr("a &amp; b"));
  EXPECT_THAT(svg, HasSubstr("puncture &lt;wall&gt;"));
  EXPECT_THAT(svg, HasSubstr("time (s)"));
  EXPECT_THAT(svg, HasSubstr(">2</text>"));   // the peak, a round number
  EXPECT_THAT(svg, HasSubstr(">10</text>"));  // the end
  EXPECT_EQ(svg.find("nan"), std::string::npos);
  EXPECT_EQ(svg.find("inf"), std::string::npos);
}

TEST(ForcePlot, LabelsNoMarkOverTheLabelOfTheLast) {
  ForceTrace trace;
  for (int i = 0; i <= 100; ++i) trace.add(0.6 * i, 0.02 * i);
  const std::array<PlotMark, 3> marks{{{5.0, "first"}, {5.1, "at once"}, {7.0, "later"}}};
  const PlotCurve curve{"driver", &trace};
  const std::string svg = force_plot_svg({&curve, 1}, marks, "many");
  EXPECT_THAT(svg, HasSubstr("first"));
  EXPECT_EQ(svg.find("at once"), std::string::npos);
  EXPECT_THAT(svg, HasSubstr("later"));
}

TEST(ForcePlot, TakesNothingAndZeroForces) {
  for (const bool some : {false, true}) {
    ForceTrace trace;
    if (some) trace.add(0.0, 0.0);
    const PlotCurve curve{"driver", &trace};
    const std::string svg = force_plot_svg({&curve, 1}, {}, "still");
    EXPECT_THAT(svg, HasSubstr("</svg>"));
    EXPECT_EQ(svg.find("nan"), std::string::npos);
    EXPECT_EQ(svg.find("inf"), std::string::npos);
  }
}

TEST(ForcePlot, CoversAndNamesEveryCurve) {
  ForceTrace early, late;
  for (int i = 0; i <= 100; ++i) early.add(0.01 * i, 0.3);
  for (int i = 0; i <= 100; ++i) late.add(1.0 + 0.04 * i, 0.02 * i);
  const std::array<PlotCurve, 2> curves{{{"driver", &early}, {"as<sistant", &late}}};
  const std::string svg = force_plot_svg(curves, {}, "two");
  EXPECT_THAT(svg, HasSubstr(">driver</text>"));
  EXPECT_THAT(svg, HasSubstr(">as&lt;sistant</text>"));
  EXPECT_THAT(svg, HasSubstr(">0</text>"));  // the beginning of one
  EXPECT_THAT(svg, HasSubstr(">5</text>"));  // and the end of the other
  EXPECT_THAT(svg, HasSubstr(">2</text>"));  // the higher peak
}

TEST(ForceLog, KeepsTheForcesOfToolsApart) {
  const std::array<std::string, 2> tools{"driver", "assistant"};
  ForceLog log("", tools);
  ForceRecord record;
  for (int i = 0; i < 100; ++i) {
    record.time_s = 0.01 * i;
    record.force.force_n = {1.0, 0.0, 0.0};
    log.push(0, record);
    record.force.force_n = {0.0, 2.0, 0.0};
    if (i % 2 == 0) log.push(1, record);
  }
  log.finish();
  EXPECT_EQ(log.dropped(), 0U);
  EXPECT_EQ(log.trace(0).size(), 100U);
  EXPECT_EQ(log.trace(1).size(), 50U);
  EXPECT_EQ(log.trace(0).begin()->max_n, 1.0);
  EXPECT_EQ(log.trace(1).begin()->max_n, 2.0);
}

TEST(ForceLog, RefusesAFileThatCannotBeWritten) {
  const std::string tool = "driver";
  EXPECT_THROW(ForceLog("/no/such/folder/log.csv", {&tool, 1}), Error);
}

}  // namespace
}  // namespace suture::cli
