// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cstdio>

#include "commands.hpp"
#include "suture/session.hpp"

namespace suture::cli {

int run_command(const CommandArguments& arguments) {
  SessionOptions options;
  options.domain = arguments.session.domain;
  options.session = arguments.session.session;
  options.timeout =
      std::chrono::milliseconds(static_cast<std::int64_t>(arguments.session.timeout_s * 1000.0));
  CommandKind kind = CommandKind::kReleaseTool;
  if (arguments.kind == "pause") kind = CommandKind::kPause;
  if (arguments.kind == "resume") kind = CommandKind::kResume;
  if (arguments.kind == "reset") kind = CommandKind::kReset;
  if (arguments.kind == "stop") kind = CommandKind::kStop;
  if (kind == CommandKind::kReleaseTool && arguments.tool.empty()) {
    throw Error(ErrorCode::kBadInput, "release needs a tool", "add --tool NAME");
  }
  Session session(options);
  const std::string text = session.command(kind, arguments.tool);
  std::printf("%s\n", text.empty() ? "done" : text.c_str());
  return kDone;
}

}  // namespace suture::cli
