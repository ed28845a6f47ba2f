// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/force_service.hpp"

#include <algorithm>
#include <bit>

#include "endpoints/wire.hpp"

namespace sutured::endpoints {

ForceService::ForceService(const suture::Participant& participant,
                           const std::vector<ServedTool>& tools)
    : secured_(participant.identity().has_value()) {
  for (const ServedTool& tool : tools) {
    auto line = std::make_unique<Line>();
    line->tool_id = suture::tool_id(tool.name);
    line->right = std::uint64_t{1} << lines_.size();  // a scene has at most eight tools
    line->partition = suture::tool_partition(tool.name);
    line->channel = tool.channel;
    lines_.push_back(std::move(line));
  }
  forces_ = suture::Writer<suture::v1::ToolForce>(participant);
  suture::EndpointCallbacks on_command;
  on_command.data_available = [this] { on_commands(); };
  commands_ = suture::Reader<suture::v1::Command>(participant, std::move(on_command));
  suture::EndpointCallbacks on_shown;
  on_shown.data_available = [this] { on_rendered(); };
  rendered_ = suture::Reader<suture::v1::ToolRendered>(participant, std::move(on_shown));
  suture::EndpointCallbacks callbacks;
  callbacks.data_available = [this] { on_poses(); };
  callbacks.matched = [this](int) { peers_changed_.store(true, std::memory_order_relaxed); };
  poses_ = suture::Reader<suture::v1::ToolPose>(participant, std::move(callbacks));
  // The listeners may have been called while the readers were still being made.
  ready_.store(true, std::memory_order_release);
}

void ForceService::on_poses() noexcept {
  if (!ready_.load(std::memory_order_acquire)) return;
  suture::v1::ToolPose pose;
  suture::SampleInfo info;
  while (poses_.take(pose, info)) {
    // A loss of liveliness changes no lease: the force ends by the age of the last pose,
    // and a device that was only held up shall not drop its needle.
    if (!info.valid) continue;
    const std::int64_t taken_ns = suture::monotonic_ns();
    Line* const found = line_of(pose.tool_id);
    if (found == nullptr) {
      strangers_.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    Line& line = *found;
    const KnownWriter* const writer = remember(info.writer);
    if (secured_ && (writer == nullptr || (writer->rights & line.right) == 0)) {
      strangers_.fetch_add(1, std::memory_order_relaxed);
      continue;
    }
    if (const auto force = line.channel->on_pose(pose_sample(pose, info.writer), taken_ns)) {
      const std::int64_t computed_ns = suture::monotonic_ns();
      send(line, *force);
      const std::int64_t sent_ns = suture::monotonic_ns();
      write_times_.record(sent_ns - computed_ns);
      line.tick_times.record(sent_ns - taken_ns);
    }
  }
}

ForceService::Line* ForceService::line_of(std::uint64_t tool_id) noexcept {
  const auto found = std::find_if(lines_.begin(), lines_.end(),
                                  [&](const auto& line) { return line->tool_id == tool_id; });
  return found == lines_.end() ? nullptr : found->get();
}

void ForceService::on_rendered() noexcept {
  if (!ready_.load(std::memory_order_acquire)) return;
  suture::v1::ToolRendered wire;
  suture::SampleInfo info;
  while (rendered_.take(wire, info)) {
    Line* const line = info.valid ? line_of(wire.tool_id) : nullptr;
    if (line == nullptr) continue;
    const std::uint64_t lease = line->channel->lease();
    if (lease == 0) continue;
    if (info.writer != line->rendered_writer || lease != line->rendered_lease) {
      // Two writers of one device share its participant: the first 12 bytes of a GUID. This
      // allocates, once an engagement.
      const auto writer = rendered_.writer_guid(info.writer);
      const suture::Guid holder = guid_of_writer(lease);
      line->rendered_writer = info.writer;
      line->rendered_lease = lease;
      line->rendered_is_ours =
          writer && std::equal(writer->begin(), writer->begin() + 12, holder.begin());
    }
    if (line->rendered_is_ours)
      line->channel->on_rendered(rendered_sample(wire), suture::monotonic_ns());
  }
}

void ForceService::on_commands() noexcept {
  if (!ready_.load(std::memory_order_acquire)) return;
  suture::v1::Command command;
  suture::SampleInfo info;
  while (commands_.take(command, info)) {
    if (!info.valid) continue;
    if (command.kind == suture_v1_COMMAND_STOP) set_stopped(true);
    if (command.kind == suture_v1_COMMAND_RESUME) set_stopped(false);
    commands_heard_.push(command);
  }
}

void ForceService::set_stopped(bool stopped) noexcept {
  for (const auto& line : lines_) line->channel->set_stopped(stopped);
  // Looked at after the resume was carried out, so that the last word is always a stop's.
  if (!stopped && stopped_for_good_.load(std::memory_order_seq_cst)) set_stopped(true);
}

void ForceService::stop_for_good() noexcept {
  stopped_for_good_.store(true, std::memory_order_seq_cst);
  set_stopped(true);
}

void ForceService::tick(std::int64_t now_ns) noexcept {
  for (const auto& line : lines_)
    if (const auto force = line->channel->supervise(now_ns)) send(*line, *force);
}

void ForceService::send(const Line& line, const haptics::ForceSample& force) noexcept {
  suture::v1::ToolForce wire{};
  wire.tool_id = line.tool_id;
  suture::set_guid(wire.device, guid_of_writer(force.writer));
  // When it was computed: what a limit in slew is held against.
  wire.stamp_ns = suture::wall_clock_ns() - (suture::monotonic_ns() - force.time_ns);
  set_force(wire, force);
  forces_.write(wire);
}

std::uint64_t ForceService::rights_of(std::uint64_t writer) const {
  const std::vector<std::string> partitions = poses_.writer_partitions(writer);
  const auto in = [&](const std::string& name) {
    return std::find(partitions.begin(), partitions.end(), name) != partitions.end();
  };
  std::uint64_t rights = 0;
  const bool every = in(suture::tool_partition("*"));
  for (const auto& line : lines_)
    if (every || in(line->partition)) rights |= line->right;
  return rights;
}

const ForceService::KnownWriter* ForceService::remember(std::uint64_t writer) noexcept {
  for (const KnownWriter& known : writers_)
    if (known.handle.load(std::memory_order_relaxed) == writer) return &known;
  const auto guid = poses_.writer_guid(writer);
  if (!guid) return nullptr;
  KnownWriter& place = writers_[next_writer_];
  next_writer_ = (next_writer_ + 1) % writers_.size();
  const auto words = std::bit_cast<std::array<std::uint64_t, 2>>(*guid);
  place.handle.store(0, std::memory_order_release);
  place.guid[0].store(words[0], std::memory_order_relaxed);
  place.guid[1].store(words[1], std::memory_order_relaxed);
  place.rights = secured_ ? rights_of(writer) : 0;
  place.handle.store(writer, std::memory_order_release);
  return &place;
}

suture::Guid ForceService::guid_of_writer(std::uint64_t writer) const noexcept {
  if (writer == 0) return suture::kNobody;
  for (const KnownWriter& known : writers_) {
    if (known.handle.load(std::memory_order_acquire) != writer) continue;
    return std::bit_cast<suture::Guid>(
        std::array<std::uint64_t, 2>{known.guid[0].load(std::memory_order_relaxed),
                                     known.guid[1].load(std::memory_order_relaxed)});
  }
  return suture::kNobody;
}

void ForceService::end_leases_of_the_departed() noexcept {
  if (!peers_changed_.exchange(false, std::memory_order_relaxed)) return;
  std::array<dds_instance_handle_t, 256> present;
  const dds_return_t found =
      dds_get_matched_publications(poses_.handle(), present.data(), present.size());
  if (found < 0) return;
  const auto end = present.begin() + std::min<std::size_t>(found, present.size());
  for (const auto& line : lines_) {
    const std::uint64_t holder = line->channel->lease();
    if (holder != 0 && std::find(present.begin(), end, holder) == end)
      line->channel->end_lease(holder);
  }
}

}  // namespace sutured::endpoints
