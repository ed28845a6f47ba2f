// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/wire.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <memory>

namespace sutured::endpoints {
namespace {

TEST(PoseSample, KeepsEveryFieldOfTheWire) {
  suture::v1::ToolPose wire{};
  wire.sequence_number = 7;
  wire.stamp_ns = 123;
  for (int i = 0; i < 3; ++i) wire.position_m[i] = i + 1;
  for (int i = 0; i < 4; ++i) wire.orientation_xyzw[i] = 10 + i;
  wire.jaw = 0.5F;
  wire.buttons = 9;
  wire.flags = suture_v1_POSE_IN_WORLD | suture_v1_POSE_STOP;
  const haptics::PoseSample sample = pose_sample(wire, 42);
  EXPECT_EQ(sample.writer, 42U);
  EXPECT_EQ(sample.sequence, 7U);
  EXPECT_EQ(sample.stamp_ns, 123);
  EXPECT_EQ(sample.pose.position_m, (std::array<double, 3>{1, 2, 3}));
  EXPECT_EQ(sample.pose.orientation_xyzw, (std::array<double, 4>{10, 11, 12, 13}));
  EXPECT_EQ(sample.jaw, 0.5);
  EXPECT_EQ(sample.buttons, 9U);
  EXPECT_EQ(sample.frame, haptics::Frame::kWorld);
  EXPECT_TRUE(sample.stop);
  EXPECT_FALSE(sample.goodbye);
}

TEST(SetForce, EchoesThePoseAndSaysWhatItIs) {
  haptics::ForceSample force;
  force.sequence = 3;
  force.pose_sequence = 8;
  force.pose_stamp_ns = 99;
  force.state = haptics::ToolState::kRamping;
  force.faults = haptics::fault_bit(haptics::Fault::kPoseJump);
  force.touching = force.from_supervisor = true;
  force.wrench = {{1, 2, 3}, {4, 5, 6}};
  force.model_age_ns = 2'500'000;
  suture::v1::ToolForce wire{};
  set_force(wire, force);
  EXPECT_EQ(wire.sequence_number, 3U);
  EXPECT_EQ(wire.pose_sequence, 8U);
  EXPECT_EQ(wire.pose_stamp_ns, 99);
  EXPECT_EQ(wire.state, suture_v1_TOOL_RAMPING);
  EXPECT_EQ(wire.faults, static_cast<std::uint32_t>(suture_v1_FAULT_POSE_JUMP));
  EXPECT_EQ(wire.flags,
            static_cast<std::uint32_t>(suture_v1_FORCE_TOUCHING | suture_v1_FORCE_FROM_SUPERVISOR));
  EXPECT_EQ(wire.force_n[2], 3.0);
  EXPECT_EQ(wire.torque_nm[0], 4.0);
  EXPECT_EQ(wire.model_age_us, 2500U);
  force.model_age_ns = -1;
  set_force(wire, force);
  EXPECT_EQ(wire.model_age_us, UINT32_MAX);
}

TEST(SetModel, LendsExactlyTheRowsInUse) {
  const auto published = std::make_unique<haptics::PublishedModel>();
  suture::HapticModel& model = published->model;
  model.rows = 3;
  model.touching = true;
  model.period_ns = 4'000'000;
  model.multiplier_max_n[2] = std::numeric_limits<double>::infinity();
  model.jacobian[2][5] = 7.0;
  model.compliance_m_per_n[suture::packed_index(2, 2)] = 8.0;
  suture::v1::HapticModel wire{};
  set_model(wire, *published, {.max_force_n = 2.0});
  ASSERT_EQ(wire.compliance_m_per_n._length, 6U);
  ASSERT_EQ(wire.jacobian._length, 18U);
  ASSERT_EQ(wire.offset_m._length, 3U);
  EXPECT_EQ(suture::span_of(wire.compliance_m_per_n)[5], 8.0);
  EXPECT_EQ(suture::span_of(wire.jacobian)[17], 7.0);
  EXPECT_EQ(suture::span_of(wire.multiplier_max_n)[2], std::numeric_limits<double>::infinity());
  EXPECT_EQ(wire.flags, static_cast<std::uint32_t>(suture_v1_MODEL_TOUCHING));
  EXPECT_EQ(wire.max_force_n, 2.0);
  EXPECT_EQ(wire.blend_ns, 4'000'000);
  EXPECT_EQ(wire.mapping.motion_scale, 1.0);
}

TEST(SetEvent, NamesEveryKindOfTheSimulation) {
  using simulation::EventKind;
  for (const auto& [kind, expected] : {std::pair{EventKind::kGrasp, suture_v1_EVENT_GRASP},
                                       {EventKind::kRelease, suture_v1_EVENT_RELEASE},
                                       {EventKind::kContact, suture_v1_EVENT_CONTACT},
                                       {EventKind::kPuncture, suture_v1_EVENT_PUNCTURE},
                                       {EventKind::kExit, suture_v1_EVENT_EXIT},
                                       {EventKind::kGripSlip, suture_v1_EVENT_GRIP_SLIP},
                                       {EventKind::kLimit, suture_v1_EVENT_LIMIT},
                                       {EventKind::kSolverResidual, suture_v1_EVENT_SOLVER},
                                       {EventKind::kInverted, suture_v1_EVENT_SOLVER}}) {
    suture::v1::Event wire{};
    set_event(wire, {kind, 1.5, "needle", "proximal", {1, 2, 3}, 0.05});
    EXPECT_EQ(wire.kind, expected);
    EXPECT_EQ(suture::text_of(wire.subject), "needle");
    EXPECT_EQ(suture::text_of(wire.object), "proximal");
    EXPECT_EQ(wire.simulation_time_s, 1.5);
    EXPECT_EQ(wire.value, 0.05);
    EXPECT_EQ(suture::text_of(wire.unit), kind == EventKind::kInverted ? "tets" : "N");
  }
}

}  // namespace
}  // namespace sutured::endpoints
