// SPDX-License-Identifier: Apache-2.0
#include <charconv>
#include <chrono>
#include <cstdio>
#include <limits>
#include <map>

#include "commands.hpp"
#include "suture/session.hpp"

namespace suture::cli {
namespace {

constexpr double kRewindMax_s = 1e6;

/// NaN where the whole text is not a number.
double seconds_in(const std::string& text) {
  double seconds = 0.0;
  const auto [end, fault] = std::from_chars(text.data(), text.data() + text.size(), seconds);
  const bool whole = fault == std::errc() && end == text.data() + text.size();
  return whole ? seconds : std::numeric_limits<double>::quiet_NaN();
}

void expect_tool(Session& session, const std::string& tool) {
  std::string known;
  for (const ToolStatus& there : session.status().tools) {
    if (there.tool == tool) return;
    known += (known.empty() ? "" : ", ") + there.tool;
  }
  throw Error(ErrorCode::kUnknownTool, "the scene has no tool \"" + tool + "\"",
              known.empty() ? "" : "it has " + known);
}

}  // namespace

int run_command(const CommandArguments& arguments) {
  SessionOptions options;
  options.domain = arguments.session.domain;
  options.session = arguments.session.session;
  options.security = arguments.session.security;
  options.network = arguments.session.network;
  options.timeout =
      std::chrono::milliseconds(static_cast<std::int64_t>(arguments.session.timeout_s * 1000.0));
  const std::map<std::string, CommandKind> kinds{
      {"pause", CommandKind::kPause},         {"resume", CommandKind::kResume},
      {"reset", CommandKind::kReset},         {"stop", CommandKind::kStop},
      {"release", CommandKind::kReleaseTool}, {"checkpoint", CommandKind::kCheckpoint},
      {"rewind", CommandKind::kRewind},       {"restore", CommandKind::kRestore},
  };
  const CommandKind kind = kinds.at(arguments.kind);
  CommandDetails details;
  details.tool = arguments.tool;
  switch (kind) {
    case CommandKind::kReleaseTool:
      if (arguments.tool.empty())
        throw Error(ErrorCode::kBadInput, "release needs a tool", "add --tool NAME");
      break;
    case CommandKind::kCheckpoint:
    case CommandKind::kRestore:
      details.checkpoint = arguments.value.empty() ? "checkpoint" : arguments.value;
      break;
    case CommandKind::kRewind:
      details.seconds = seconds_in(arguments.value);
      if (!(details.seconds > 0.0 && details.seconds <= kRewindMax_s))
        throw Error(ErrorCode::kBadInput,
                    "rewind needs to know how far, and \"" + arguments.value + "\" says it not",
                    "give seconds above 0, as in `suture command rewind 10`");
      break;
    default:
      break;
  }
  if (!arguments.tool.empty() && kind != CommandKind::kReleaseTool)
    throw Error(ErrorCode::kBadInput, arguments.kind + " is for all tools, and takes no --tool",
                "leave it out");
  if (!arguments.value.empty() && details.checkpoint.empty() && details.seconds == 0.0)
    throw Error(ErrorCode::kBadInput,
                arguments.kind + " takes no value, and \"" + arguments.value + "\" is one",
                "leave it out");
  Session session(options);
  if (kind == CommandKind::kReleaseTool) expect_tool(session, arguments.tool);
  const std::string text = session.command(kind, details);
  std::printf("%s\n", text.empty() ? "done" : text.c_str());
  return kDone;
}

}  // namespace suture::cli
