// SPDX-License-Identifier: GPL-3.0-or-later
// Between the server's values and those of idl/suture_v1.idl. Plain copies, no decisions.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haptics/period_latency.hpp"
#include "haptics/simulation_loop.hpp"
#include "haptics/tool_channel.hpp"
#include "protocol/types.hpp"
#include "scene/scene.hpp"
#include "simulation/quality.hpp"

namespace sutured::endpoints {

/// Returns a pose as a channel takes it; `writer` names who sent it, within this process.
[[nodiscard]] haptics::PoseSample pose_sample(const suture::v1::ToolPose& wire,
                                              std::uint64_t writer) noexcept;

/// Returns what a device says that it showed; what is not finite is zero.
[[nodiscard]] haptics::RenderedSample rendered_sample(
    const suture::v1::ToolRendered& wire) noexcept;

/// Returns the limits that a device tells of itself.
[[nodiscard]] haptics::DeviceLimits device_limits(const suture::v1::DeviceProfile& wire) noexcept;

/// Fills `wire` but for its tool, device and stamp.
void set_force(suture::v1::ToolForce& wire, const haptics::ForceSample& force) noexcept;

[[nodiscard]] suture_v1_ToolState wire_state(haptics::ToolState state) noexcept;

/// Fills `wire` but for its tool and device. Its sequences lend from `published` and from
/// `couplings`, which is overwritten; both must outlive the write. `names` are the scene's tools.
void set_model(suture::v1::HapticModel& wire, const haptics::PublishedModel& published,
               const suture::ForceLimits& limits, std::span<const std::string> names,
               std::array<suture::v1::ToolCoupling, suture::kModelOthersMax>& couplings) noexcept;

/// Fills kind, subject, object, position and value of `wire`.
void set_event(suture::v1::Event& wire, const simulation::Event& event) noexcept;

/// Returns the name of the thing in a jaw; empty for none.
[[nodiscard]] std::string_view held_name(const scene::Scene& scene,
                                         const simulation::HeldThing& held) noexcept;

/// Fills `wire` but for its epoch, number and stamp. Its sequences lend from `course_m` and
/// `punctures`, which are overwritten and must outlive the write.
void set_needle(suture::v1::NeedleState& wire, const scene::Scene& scene, std::size_t needle,
                const simulation::NeedleState& state, std::vector<double>& course_m,
                std::vector<suture::v1::Puncture>& punctures);

/// Fills `wire` but for its epoch, number and stamp. Its sequences lend from `state` and
/// `punctures`, which is overwritten; both must outlive the write.
void set_thread(suture::v1::ThreadState& wire, const scene::Scene& scene, std::size_t thread,
                const simulation::ThreadState& state, std::vector<suture::v1::Puncture>& punctures);

/// Fills the points of `wire`. They lend from `points`, which is overwritten and must outlive
/// the write.
void set_contacts(suture::v1::ContactState& wire, const scene::Scene& scene,
                  std::span<const simulation::ContactPoint> contacts,
                  std::vector<suture::v1::ContactPoint>& points);

/// Fills `wire` but for its epoch, number and stamp. Its bites lend from `bites`, which is
/// overwritten and must outlive the write.
void set_quality(suture::v1::Quality& wire, const scene::Scene& scene, std::size_t thread,
                 const simulation::ThreadQuality& quality, std::vector<suture::v1::Bite>& bites);

[[nodiscard]] suture::v1::Percentiles percentiles(const haptics::LatencySummary& summary) noexcept;

}  // namespace sutured::endpoints
