// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/metrics.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <regex>
#include <sstream>

namespace sutured::gateway {
namespace {

using ::testing::HasSubstr;

std::string text_of_a_busy_server() {
  suture::v1::ServerStatus status{};
  suture::set_text(status.scene, "line\nbreak \"quoted\" \\");
  status.overruns = 3;
  status.state = suture_v1_SERVER_PAUSED;
  static std::array<suture::v1::ToolStatus, 2> tools{};
  suture::set_text(tools[0].tool, "left");
  tools[0].fault_count = 5;
  suture::set_text(tools[1].tool, "right");
  suture::lend(status.tools, std::span<const suture::v1::ToolStatus>(tools));
  static std::array<suture::v1::StageTime, 1> stages{};
  suture::set_text(stages[0].stage, "solve");
  stages[0].mean_us = 250.0;
  suture::lend(status.stages, std::span<const suture::v1::StageTime>(stages));
  WebCounters web;
  web.bytes_sent = 12345678901;
  return metrics_text(&status, web, {.clients = 2, .dropped = 7, .waiting_bytes = 0});
}

TEST(Metrics, TellsWhatTheServerSays) {
  const std::string text = text_of_a_busy_server();
  EXPECT_THAT(text, HasSubstr("\nsutured_overruns_total 3\n"));
  EXPECT_THAT(text, HasSubstr("\nsutured_state{state=\"paused\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("\nsutured_tool_faults_total{tool=\"left\"} 5\n"));
  EXPECT_THAT(text, HasSubstr("\nsutured_stage_seconds{stage=\"solve\"} 0.00025\n"));
  EXPECT_THAT(text, HasSubstr("\nsutured_web_clients 2\n"));
  EXPECT_THAT(text, HasSubstr("\nsutured_web_sent_bytes_total 12345678901\n"));
  EXPECT_THAT(text, HasSubstr("scene=\"line\\nbreak \\\"quoted\\\" \\\\\""));
}

TEST(Metrics, EveryLineKeepsToThePrometheusTextFormat) {
  const std::regex comment(R"(# (HELP|TYPE) [a-z_0-9]+ .+)");
  const std::regex sample(
      R"([a-z_0-9]+(\{[a-z]+="([^"\\\n]|\\.)*"(,[a-z]+="([^"\\\n]|\\.)*")*\})? [-+0-9.e]+)");
  std::istringstream text(text_of_a_busy_server());
  std::string line;
  int samples = 0;
  while (std::getline(text, line)) {
    const bool is_sample = std::regex_match(line, sample);
    EXPECT_TRUE(is_sample || std::regex_match(line, comment)) << line;
    samples += is_sample ? 1 : 0;
  }
  EXPECT_GT(samples, 50);
}

TEST(Metrics, TellsItsOwnCountersWhereNoServerAnswers) {
  const std::string text = metrics_text(nullptr, {}, {});
  EXPECT_THAT(text, HasSubstr("sutured_web_clients 0\n"));
  EXPECT_THAT(text, ::testing::Not(HasSubstr("sutured_steps_total")));
}

}  // namespace
}  // namespace sutured::gateway
