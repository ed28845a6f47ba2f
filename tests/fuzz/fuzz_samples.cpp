// SPDX-License-Identifier: GPL-3.0-or-later
// Samples of every topic, as the bytes that a peer may send: those that Cyclone takes go to whoever
// accepts such a sample. The first byte chooses the topic, 'a' + its place in all_topics().
//
//     poses, profiles        the tool's channel: each force is finite, within limits and slew
//     models                 the SDK's renderer: the same
//     all that is looked at  the SDK's values, the gateway's picture and metrics
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <optional>
#include <string>

#include "convert.hpp"
#include "endpoints/wire.hpp"
#include "force_guard.hpp"
#include "gateway/metrics.hpp"
#include "gateway/scene_composer.hpp"
#include "haptics/tool_channel.hpp"
#include "model_renderer.hpp"
#include "protocol/serialized.hpp"
#include "scene/scene.hpp"
#include "support/spring_model.hpp"

namespace {

using namespace suture;
using Bytes = std::span<const std::byte>;

constexpr std::int64_t kMs = 1'000'000;

void require(bool holds) {
  if (!holds) std::abort();
}

double norm(const Vector3& v) { return std::hypot(v[0], v[1], v[2]); }

/// One participant of each channel, on this machine alone.
struct Network {
  Network() {
    options.domain = 2U * (static_cast<std::uint32_t>(getpid()) % 100U);
    options.session = "fuzz-" + std::to_string(getpid());
    control.emplace(options, Channel::kControl);
    mesh.emplace(options, Channel::kMesh);
  }
  ParticipantOptions options;
  std::optional<Participant> control, mesh;
};

Network& network() {
  static Network instance;
  return instance;
}

template <class T>
const SampleCodec& codec() {
  const TopicSpec& spec = topic<T>();
  static const SampleCodec instance(
      spec.channel == Channel::kControl ? *network().control : *network().mesh, *spec.descriptor,
      spec.name);
  return instance;
}

// ------------------------------------------------------------------ server

HapticModel pressed() {
  HapticModel model;
  model.epoch = 1;
  model.period_ns = 4 * kMs;
  model.touching = true;
  model.bilateral_wrench.force_n[0] = 0.5;
  for (std::size_t i = 0; i < 3; ++i) model.bilateral_stiffness[7 * i] = 100.0;
  complete_model(model);
  return model;
}

/// A tool whose device says what the bytes say, a pose each 128 of them, a millisecond apart.
void poses(Bytes bytes, const std::optional<v1::DeviceProfile>& profile = std::nullopt) {
  using namespace sutured;
  const scene::Tool tool;
  haptics::ToolChannel channel(tool, 4 * kMs);
  if (profile) channel.set_device_limits(endpoints::device_limits(*profile));
  HapticModel model = pressed();
  haptics::ForceSample last;
  std::int64_t now_ns = 1000 * kMs;
  const auto look = [&](const std::optional<haptics::ForceSample>& force) {
    if (!force) return;
    const ForceLimits limits = channel.limits();
    require(limits.max_force_n <= tool.max_force_n && limits.max_force_n >= 0.0);
    require(norm(force->wrench.force_n) <= limits.max_force_n * (1.0 + 1e-9));
    require(norm(force->wrench.torque_nm) <= limits.max_torque_nm * (1.0 + 1e-9));
    Vector3 step;
    for (std::size_t i = 0; i < 3; ++i) step[i] = force->wrench.force_n[i] - last.wrench.force_n[i];
    const double elapsed_s = 1e-9 * static_cast<double>(force->time_ns - last.time_ns);
    if (last.time_ns != 0 && last.frame == force->frame)
      require(norm(step) <= limits.max_force_slew_n_per_s * elapsed_s * (1.0 + 1e-9) + 1e-12);
    last = *force;
    v1::ToolForce wire{};
    endpoints::set_force(wire, *force);
  };
  const auto tick = [&](const v1::ToolPose& wire) {
    if (now_ns / kMs % 4 == 0) {
      ++model.sequence;
      model.reference = channel.target().pose;
      channel.publish_model(model, now_ns, now_ns);
    }
    look(channel.on_pose(endpoints::pose_sample(wire, 7), now_ns));
    look(channel.supervise(now_ns + kMs / 2));
    now_ns += kMs;
  };
  v1::ToolPose good{};
  good.orientation_xyzw[3] = 1.0;
  const auto play_good = [&](int count) {
    for (int i = 0; i < count; ++i) {
      ++good.sequence_number;
      good.stamp_ns = now_ns;
      tick(good);
    }
  };
  play_good(60);
  constexpr std::size_t kPose = 128;
  for (; !bytes.empty(); bytes = bytes.subspan(std::min(kPose, bytes.size()))) {
    v1::ToolPose wire;
    if (codec<v1::ToolPose>().decode(bytes.first(std::min(kPose, bytes.size())), wire)) tick(wire);
    play_good(2);
  }
  play_good(60);
}

// ------------------------------------------------------------------ SDK

/// A device that rendered a good model, and then gets this one.
void model(const v1::HapticModel& wire) {
  const v1::HapticModel first = sutured::testing::spring_model(100.0);
  for (const double stiffest_n_per_m : {0.0, 50.0}) {
    DeviceLimits device;
    device.max_stiffness_n_per_m = stiffest_n_per_m;
    device.max_damping_n_s_per_m = 0.02 * stiffest_n_per_m;
    const auto renderer = std::make_unique<ModelRenderer>(device, 2.0);
    Force server;
    server.state = ForceState::kRendering;
    Hand hand;
    hand.in_world = true;
    hand.position_m = {0.01, 0.0, 0.0};
    std::int64_t now_ns = 1000 * kMs;
    const auto tick = [&] {
      now_ns += kMs;
      const Force force = renderer->render(hand, now_ns, server, false, now_ns);
      // A limit that falls is reached at the slew limit.
      const ForceLimits& limits = renderer->current().limits;
      require(norm(force.force_n) <=
              std::max(first.max_force_n, limits.max_force_n) * (1.0 + 1e-9));
      require(norm(force.torque_nm) <=
              std::max(first.max_torque_nm, limits.max_torque_nm) * (1.0 + 1e-9));
    };
    for (int i = 0; i < 60; ++i) {
      renderer->receive(first, now_ns);
      tick();
    }
    renderer->others().receive(wire);
    renderer->receive(wire, now_ns);
    for (int i = 0; i < 20; ++i) {
      hand.in_world = i < 10;
      tick();
    }
  }
}

void force(const v1::ToolForce& wire) {
  OtherTools others;
  others.receive(wire);
}

void show(const v1::ServerStatus& wire) {
  (void)to_status(wire);
  (void)sutured::gateway::metrics_text(&wire, {}, {});
}

// ------------------------------------------------------------------ gateway

/// Draws what it hears. Begun anew now and then, since names of things pile up in readers.
void draw(const TopicSpec& spec, Bytes bytes) {
  static std::unique_ptr<sutured::gateway::SceneComposer> composer;
  static int drawn = 0;
  if (drawn++ % 1000 == 0) {
    composer = std::make_unique<sutured::gateway::SceneComposer>(*network().mesh);
    composer->watch(true);
  }
  SerializedWriter writer(*network().mesh, spec);
  writer.write(bytes);
  (void)composer->compose();
}

template <class T, class Use>
bool meet(const TopicSpec& spec, Bytes bytes, Use&& use) {
  if (&spec != &topic<T>()) return false;
  codec<T>().template with_decoded<T>(bytes, use);
  return true;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto topics = all_topics();
  if (size == 0 || data[0] < 'a' || data[0] >= 'a' + topics.size()) return 0;
  const TopicSpec& spec = topics[static_cast<std::size_t>(data[0] - 'a')];
  const Bytes bytes = std::as_bytes(std::span(data + 1, size - 1));
  if (&spec == &topic<v1::ToolPose>()) poses(bytes);
  meet<v1::DeviceProfile>(spec, bytes, [](const auto& wire) { poses({}, wire); });
  meet<v1::ToolRendered>(spec, bytes, [](const auto& wire) {
    const auto sample = sutured::endpoints::rendered_sample(wire);
    require(std::isfinite(norm(sample.wrench.force_n)));
  });
  meet<v1::HapticModel>(spec, bytes, model);
  meet<v1::ToolForce>(spec, bytes, force);
  meet<v1::ServerStatus>(spec, bytes, show);
  meet<v1::Event>(spec, bytes, [](const auto& wire) { (void)to_event(wire); });
  meet<v1::Quality>(spec, bytes, [](const auto& wire) { (void)to_quality(wire); });
  meet<v1::MeshTopology>(spec, bytes, [](const auto& wire) { (void)to_topology(wire); });
  meet<v1::MeshFrame>(spec, bytes, [](const auto& wire) { (void)to_frame(wire); });
  meet<v1::ToolView>(spec, bytes, [](const auto& wire) { (void)to_tool(wire); });
  meet<v1::NeedleState>(spec, bytes, [](const auto& wire) { (void)to_needle(wire); });
  meet<v1::ThreadState>(spec, bytes, [](const auto& wire) { (void)to_thread(wire); });
  meet<v1::ContactState>(spec, bytes, [](const auto& wire) { (void)to_contacts(wire); });
  meet<v1::Command>(spec, bytes, [](const auto& wire) { (void)text_of(wire.checkpoint); });
  meet<v1::CommandReply>(spec, bytes, [](const auto& wire) { (void)text_of(wire.text); });
  if (spec.channel == Channel::kMesh) draw(spec, bytes);
  return 0;
}
