// SPDX-License-Identifier: GPL-3.0-or-later
// The server's end of the protocol with the simplest thing behind it: a spring to the
// origin. It lets the SDK be tested over real DDS without a simulation.
#pragma once

#include <atomic>
#include <mutex>
#include <string>
#include <vector>

#include "protocol/endpoint.hpp"

namespace sutured::testing {

class SpringServer {
 public:
  struct Options {
    suture::ParticipantOptions session;
    std::string scene = "spring";
    std::vector<std::string> tools{"driver"};
    std::uint32_t protocol_version = suture_v1_PROTOCOL_VERSION;
    double stiffness_n_per_m = 100.0;
  };

  explicit SpringServer(Options options)
      : options_(std::move(options)), participant_(options_.session, suture::Channel::kControl) {
    status_writer_ = suture::Writer<suture::v1::ServerStatus>(participant_);
    force_writer_ = suture::Writer<suture::v1::ToolForce>(participant_);
    reply_writer_ = suture::Writer<suture::v1::CommandReply>(participant_);
    event_writer_ = suture::Writer<suture::v1::Event>(participant_);
    suture::EndpointCallbacks on_pose;
    on_pose.data_available = [this] { answer_poses(); };
    pose_reader_ = suture::Reader<suture::v1::ToolPose>(participant_, std::move(on_pose));
    suture::EndpointCallbacks on_command;
    on_command.data_available = [this] { answer_commands(); };
    command_reader_ = suture::Reader<suture::v1::Command>(participant_, std::move(on_command));
    ready_.store(true);
    publish_status();
  }

  /// Writes the status; `holder` is the lease holder of the first tool.
  void publish_status(const suture::Guid& holder = suture::kNobody) {
    std::vector<suture::v1::ToolStatus> tools(options_.tools.size());
    for (std::size_t i = 0; i < tools.size(); ++i) {
      suture::set_text(tools[i].tool, options_.tools[i]);
      suture::set_text(tools[i].kind, "driver");
      tools[i].max_force_n = 3.3;
    }
    if (!tools.empty()) {
      tools[0].leased = holder != suture::kNobody;
      suture::set_guid(tools[0].device, holder);
    }
    suture::v1::ServerStatus status{};
    status.epoch = 1;
    status.protocol_version = options_.protocol_version;
    status.state = suture_v1_SERVER_RUNNING;
    suture::set_text(status.server_version, "0.1.0");
    suture::set_text(status.session, options_.session.session);
    suture::set_text(status.host, "here");
    suture::set_text(status.scene, options_.scene);
    suture::lend(status.tools, std::span<const suture::v1::ToolStatus>(tools));
    status_writer_.write(status);
  }

  void publish_event(const suture::v1::Event& event) { event_writer_.write(event); }

  /// Answers no more, or again.
  void set_silent(bool silent) { silent_ = silent; }
  /// Answers poses of that tool no more; "" answers all again.
  void set_silent_for(const std::string& tool) { silent_tool_ = suture::tool_id(tool); }
  /// Gives the forces of that tool to a device that is not there.
  void give_away(const std::string& tool) { given_tool_ = suture::tool_id(tool); }
  /// Gives every force to that device instead of the sender of the pose.
  void set_holder(const suture::Guid& holder) {
    const std::lock_guard lock(mutex_);
    holder_ = holder;
  }
  /// Sends forces that are not finite.
  void set_nonsense(bool nonsense) { nonsense_ = nonsense; }
  [[nodiscard]] int goodbyes() const { return goodbyes_; }
  [[nodiscard]] suture::v1::ToolPose last_pose() {
    const std::lock_guard lock(mutex_);
    return last_pose_;
  }
  /// The writer of the last pose.
  [[nodiscard]] suture::Guid last_sender() {
    const std::lock_guard lock(mutex_);
    return last_sender_;
  }
  [[nodiscard]] int matched_devices() const { return pose_reader_.matched(); }

 private:
  void answer_poses() {
    if (!ready_) return;
    suture::v1::ToolPose pose;
    suture::SampleInfo info;
    while (pose_reader_.take(pose, info)) {
      if (!info.valid) continue;
      if ((pose.flags & suture_v1_POSE_GOODBYE) != 0) ++goodbyes_;
      const std::lock_guard lock(mutex_);
      last_pose_ = pose;
      last_sender_ = pose_reader_.writer_guid(info.writer).value_or(suture::kNobody);
      if (silent_ || pose.tool_id == silent_tool_) continue;
      suture::v1::ToolForce force{};
      force.tool_id = pose.tool_id;
      suture::set_guid(force.device, holder_ != suture::kNobody ? holder_ : last_sender_);
      if (pose.tool_id == given_tool_) force.device[0] ^= 0xffU;
      force.epoch = 1;
      force.sequence_number = ++sequence_;
      force.stamp_ns = suture::wall_clock_ns();
      force.pose_sequence = pose.sequence_number;
      force.pose_stamp_ns = pose.stamp_ns;
      force.state = suture_v1_TOOL_RENDERING;
      for (int i = 0; i < 3; ++i) {
        force.force_n[i] = nonsense_ ? std::numeric_limits<double>::quiet_NaN()
                                     : -options_.stiffness_n_per_m * pose.position_m[i];
      }
      force_writer_.write(force);
    }
  }

  void answer_commands() {
    if (!ready_) return;
    suture::v1::Command command;
    suture::SampleInfo info;
    while (command_reader_.take(command, info)) {
      if (!info.valid) continue;
      suture::v1::CommandReply reply{};
      std::memcpy(reply.requester, command.requester, sizeof reply.requester);
      reply.request = command.request;
      reply.kind = command.kind;
      reply.epoch = command.kind == suture_v1_COMMAND_RESET ? 2 : 1;
      const bool refused = command.kind == suture_v1_COMMAND_STOP;
      reply.result = refused ? suture_v1_COMMAND_REFUSED : suture_v1_COMMAND_DONE;
      suture::set_text(reply.text, refused ? "springs do not stop" : "done");
      reply_writer_.write(reply);
    }
  }

  Options options_;
  suture::Participant participant_;
  std::atomic<bool> ready_{false}, silent_{false}, nonsense_{false};
  std::atomic<std::uint64_t> silent_tool_{suture::tool_id("")}, given_tool_{suture::tool_id("")};
  std::atomic<int> goodbyes_{0};
  std::mutex mutex_;
  suture::Guid holder_{};
  suture::v1::ToolPose last_pose_{};
  suture::Guid last_sender_{};
  std::uint64_t sequence_ = 0;
  suture::Writer<suture::v1::ServerStatus> status_writer_;
  suture::Writer<suture::v1::ToolForce> force_writer_;
  suture::Writer<suture::v1::CommandReply> reply_writer_;
  suture::Writer<suture::v1::Event> event_writer_;
  suture::Reader<suture::v1::ToolPose> pose_reader_;
  suture::Reader<suture::v1::Command> command_reader_;
};

}  // namespace sutured::testing
