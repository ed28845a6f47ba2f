// SPDX-License-Identifier: Apache-2.0
#include "suture/session.hpp"

#include <algorithm>

#include "convert.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/rendezvous.hpp"

namespace suture {
namespace {

using Clock = std::chrono::steady_clock;

const char* name_of(CommandKind kind) noexcept {
  switch (kind) {
    case CommandKind::kPause:
      return "pause";
    case CommandKind::kResume:
      return "resume";
    case CommandKind::kReset:
      return "reset";
    case CommandKind::kStop:
      return "stop";
    case CommandKind::kReleaseTool:
      return "release";
    case CommandKind::kCheckpoint:
      return "checkpoint";
    case CommandKind::kRewind:
      return "rewind";
    case CommandKind::kRestore:
      return "restore";
  }
  return "unknown";
}

}  // namespace

struct Session::State {
  explicit State(const SessionOptions& chosen)
      : options(chosen),
        control({.domain = options.domain,
                 .session = options.session,
                 .security = options.security,
                 .network = options.network},
                Channel::kControl),
        server(await_server(control, options.timeout)),
        status_reader(control) {
    status_waitset.attach(status_reader);
  }
  /// Only who commands needs the right to.
  void prepare_commands() {
    if (writer.handle() != 0) return;
    reply_reader = Reader<v1::CommandReply>(control);
    reply_waitset.attach(reply_reader);
    writer = Writer<v1::Command>(control);
  }

  SessionOptions options;
  Participant control;
  ServerInfo server;
  Reader<v1::ServerStatus> status_reader;
  Reader<v1::CommandReply> reply_reader;
  Writer<v1::Command> writer;
  WaitSet status_waitset;
  WaitSet reply_waitset;
  std::optional<Status> last;
  std::uint64_t request = 0;
};

Session::Session(const SessionOptions& options) : state_(std::make_unique<State>(options)) {}
Session::~Session() = default;
Session::Session(Session&&) noexcept = default;
Session& Session::operator=(Session&&) noexcept = default;

std::optional<Status> Session::next_status(std::chrono::nanoseconds timeout) {
  const Clock::time_point end = Clock::now() + timeout;
  std::optional<Status> next;
  for (;;) {
    state_->status_reader.take_each([&](const v1::ServerStatus& wire, const SampleInfo& info) {
      if (info.valid && wire.epoch != 0) next = to_status(wire);
    });
    if (next) break;
    const auto left = end - Clock::now();
    if (left.count() <= 0) return std::nullopt;
    state_->status_waitset.wait(left);
  }
  state_->last = next;
  return next;
}

Status Session::status() {
  if (!state_->last && !next_status(state_->options.timeout)) {
    throw Error(ErrorCode::kNoServer, "the server has left", "start it again");
  }
  // Whatever arrived since the last call is newer.
  while (next_status({})) {
  }
  return *state_->last;
}

std::string Session::command(CommandKind kind, const CommandDetails& details) {
  State& state = *state_;
  state.prepare_commands();
  const Clock::time_point end = Clock::now() + state.options.timeout;
  // Commands are not kept for late joiners: the server must hear this writer first, and be
  // heard. Discovery is an affair of milliseconds and gives no other sign than this count.
  while (state.writer.matched() == 0 || state.reply_reader.matched() == 0) {
    if (Clock::now() > end) {
      throw Error(ErrorCode::kNoServer, "the server takes no commands",
                  "with DDS Security, check this client's permissions");
    }
    state.status_waitset.wait(std::chrono::milliseconds(2));
  }
  v1::Command command{};
  set_guid(command.requester, state.writer.guid());
  command.epoch = state.server.epoch;
  command.request = ++state.request;
  command.stamp_ns = wall_clock_ns();
  command.kind = to_wire(kind);
  if (!set_text(command.tool, details.tool)) {
    throw Error(ErrorCode::kBadInput, "no tool has a name of more than 32 characters", "");
  }
  if (!set_text(command.checkpoint, details.checkpoint)) {
    throw Error(ErrorCode::kBadInput, "no checkpoint has a name of more than 32 characters", "");
  }
  command.seconds = details.seconds;
  set_text(command.requester_name, "suture");
  state.writer.write(command);

  std::optional<v1::CommandReply> reply;
  while (!reply && Clock::now() < end) {
    state.reply_waitset.wait(end - Clock::now());
    state.reply_reader.take_each([&](const v1::CommandReply& wire, const SampleInfo& info) {
      if (info.valid && wire.request == command.request &&
          guid_of(wire.requester) == state.writer.guid()) {
        reply = wire;
      }
    });
  }
  if (!reply) {
    throw Error(ErrorCode::kNoServer,
                std::string("no reply to the command \"") + name_of(kind) + "\"",
                "see whether the server still runs (`suture top`)");
  }
  state.server.epoch = reply->epoch;
  std::string text(text_of(reply->text));
  if (reply->result != suture_v1_COMMAND_DONE) {
    throw Error(ErrorCode::kPermissionDenied,
                std::string("the server refuses the command \"") + name_of(kind) + "\"", text);
  }
  return text;
}

}  // namespace suture
