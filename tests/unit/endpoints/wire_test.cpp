// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/wire.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

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

TEST(DeviceLimits, KeepWhatAProfileTells) {
  suture::v1::DeviceProfile wire{};
  wire.max_force_n = 1.0;
  wire.max_torque_nm = 2.0;
  wire.max_force_slew_n_per_s = 3.0;
  wire.max_stiffness_n_per_m = 4.0;
  wire.max_damping_n_s_per_m = 5.0;
  wire.pointer = true;
  const haptics::DeviceLimits limits = device_limits(wire);
  EXPECT_EQ(limits.force.max_force_n, 1.0);
  EXPECT_EQ(limits.force.max_torque_nm, 2.0);
  EXPECT_EQ(limits.force.max_force_slew_n_per_s, 3.0);
  EXPECT_EQ(limits.max_stiffness_n_per_m, 4.0);
  EXPECT_EQ(limits.max_damping_n_s_per_m, 5.0);
  EXPECT_TRUE(limits.pointer);
}

TEST(SetForce, EchoesThePoseAndSaysWhatItIs) {
  haptics::ForceSample force;
  force.sequence = 3;
  force.pose_sequence = 8;
  force.pose_stamp_ns = 99;
  force.state = haptics::ToolState::kRamping;
  force.faults = haptics::fault_bit(haptics::Fault::kPoseJump);
  force.touching = force.holding = force.from_supervisor = true;
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
            static_cast<std::uint32_t>(suture_v1_FORCE_TOUCHING | suture_v1_FORCE_HOLDING |
                                       suture_v1_FORCE_FROM_SUPERVISOR));
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
  model.touching = model.holding = true;
  model.period_ns = 4'000'000;
  model.multiplier_max_n[2] = std::numeric_limits<double>::infinity();
  model.bound_row[1] = 2;
  model.bound_slope[1] = 0.5;
  model.jacobian[2][5] = 7.0;
  model.compliance_m_per_n[suture::packed_index(2, 2)] = 8.0;
  suture::v1::HapticModel wire{};
  std::array<suture::v1::ToolCoupling, suture::kModelOthersMax> couplings{};
  set_model(wire, *published, {.max_force_n = 2.0}, {}, couplings);
  EXPECT_EQ(wire.others._length, 0U);
  ASSERT_EQ(wire.compliance_m_per_n._length, 6U);
  ASSERT_EQ(wire.jacobian._length, 18U);
  ASSERT_EQ(wire.offset_m._length, 3U);
  EXPECT_EQ(suture::span_of(wire.compliance_m_per_n)[5], 8.0);
  EXPECT_EQ(suture::span_of(wire.jacobian)[17], 7.0);
  EXPECT_EQ(suture::span_of(wire.multiplier_max_n)[2], std::numeric_limits<double>::infinity());
  ASSERT_EQ(wire.bound_row._length, 3U);
  ASSERT_EQ(wire.bound_slope._length, 3U);
  EXPECT_EQ(suture::span_of(wire.bound_row)[1], 2);
  EXPECT_EQ(suture::span_of(wire.bound_slope)[1], 0.5);
  EXPECT_EQ(wire.flags,
            static_cast<std::uint32_t>(suture_v1_MODEL_TOUCHING | suture_v1_MODEL_HOLDING));
  EXPECT_EQ(wire.max_force_n, 2.0);
  EXPECT_EQ(wire.blend_ns, 4'000'000);
  EXPECT_EQ(wire.mapping.motion_scale, 1.0);
}

TEST(SetModel, NamesTheToolsThatItIsCoupledTo) {
  const auto published = std::make_unique<haptics::PublishedModel>();
  suture::HapticModel& model = published->model;
  model.rows = 2;
  model.other_count = 1;
  model.others[0].tool = 1;
  model.others[0].reference.position_m = {1, 2, 3};
  model.others[0].stiffness[7] = 4.0;
  model.others[0].jacobian[1][5] = 5.0;
  const std::vector<std::string> names = {"driver", "assistant"};
  std::array<suture::v1::ToolCoupling, suture::kModelOthersMax> couplings{};
  suture::v1::HapticModel wire{};
  set_model(wire, *published, {}, names, couplings);
  ASSERT_EQ(wire.others._length, 1U);
  const suture::v1::ToolCoupling& other = suture::span_of(wire.others)[0];
  EXPECT_EQ(suture::text_of(other.tool), "assistant");
  EXPECT_EQ(other.position_m[2], 3.0);
  EXPECT_EQ(other.orientation_xyzw[3], 1.0);
  EXPECT_EQ(other.stiffness[7], 4.0);
  ASSERT_EQ(other.jacobian._length, 12U);
  EXPECT_EQ(suture::span_of(other.jacobian)[11], 5.0);
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

scene::Scene named_scene() {
  scene::Scene scene;
  scene.tissues.resize(2);
  scene.tissues[0].name = "proximal";
  scene.tissues[1].name = "distal";
  scene.needles.resize(1);
  scene.needles[0].name = "needle";
  scene.tools.resize(2);
  scene.tools[0].name = "driver";
  scene.tools[1].name = "assistant";
  scene.threads.resize(1);
  scene.threads[0].name = "thread";
  scene.threads[0].diameter_m = 0.0002;
  return scene;
}

TEST(HeldName, ResolvesEveryKindInItsOwnList) {
  using simulation::HeldKind;
  const scene::Scene scene = named_scene();
  EXPECT_EQ(held_name(scene, {}), "");
  EXPECT_EQ(held_name(scene, {HeldKind::kNeedle, 0}), "needle");
  EXPECT_EQ(held_name(scene, {HeldKind::kTissue, 1}), "distal");
  EXPECT_EQ(held_name(scene, {HeldKind::kThread, 0}), "thread");
  EXPECT_EQ(held_name(scene, {HeldKind::kThread, 7}), "");  // no such: no name, and no crash
}

TEST(SetNeedle, SaysWhereItIsAndWhereItPassesSurfaces) {
  scene::Scene scene = named_scene();
  scene.needles[0].shape = scene::NeedleShape::kStraight;
  scene.needles[0].length_m = 0.025;
  scene.needles[0].diameter_m = 0.0004;
  simulation::NeedleState state;
  state.position_m = {1, 2, 3};
  state.holder = 1;
  state.active_cells = 7;
  state.embedded_length_m = 0.01;
  state.tip_force_n = 0.05;
  state.tip_inside = true;
  state.punctures = {{1, {7, 8, 9}, 0.002, true}, {0, {4, 5, 6}, 0.012, false}};
  std::vector<double> course_m(5);  // of the needle before, like the next
  std::vector<suture::v1::Puncture> punctures(5);
  suture::v1::NeedleState wire{};
  set_needle(wire, scene, 0, state, course_m, punctures);
  EXPECT_EQ(suture::text_of(wire.needle), "needle");
  EXPECT_EQ(wire.shape, suture_v1_NEEDLE_STRAIGHT);
  EXPECT_EQ(wire.length_m, 0.025);
  EXPECT_EQ(wire.diameter_m, 0.0004);
  EXPECT_EQ(wire.position_m[1], 2.0);
  EXPECT_EQ(wire.orientation_xyzw[3], 1.0);
  EXPECT_EQ(suture::text_of(wire.holder), "assistant");
  EXPECT_TRUE(wire.tip_inside);
  EXPECT_EQ(wire.tip_force_n, 0.05);
  EXPECT_EQ(wire.embedded_length_m, 0.01);
  EXPECT_EQ(wire.active_cells, 7U);
  ASSERT_EQ(wire.course_m._length, 99U);
  EXPECT_DOUBLE_EQ(wire.course_m._buffer[0], 1.025);  // the tip first
  EXPECT_DOUBLE_EQ(wire.course_m._buffer[96], 1.0);
  const auto got = suture::span_of(wire.punctures);
  ASSERT_EQ(got.size(), 2U);
  EXPECT_EQ(suture::text_of(got[0].body), "distal");
  EXPECT_EQ(got[0].position_m[2], 9.0);
  EXPECT_EQ(got[0].arc_length_m, 0.002);
  EXPECT_TRUE(got[0].inward);
  EXPECT_EQ(suture::text_of(got[1].body), "proximal");
  EXPECT_FALSE(got[1].inward);
  state.holder = -1;
  state.punctures.clear();
  set_needle(wire, scene, 0, state, course_m, punctures);
  EXPECT_EQ(wire.punctures._length, 0U);
}

TEST(SetThread, NamesTheHolderOfEachEndByItsKind) {
  using simulation::ThreadEnd;
  const scene::Scene scene = named_scene();
  simulation::ThreadState state;
  std::vector<suture::v1::Puncture> punctures;
  const auto holder = [&](ThreadEnd end, int index) {
    state.head = end;
    state.head_holder = index;
    suture::v1::ThreadState wire{};
    set_thread(wire, scene, 0, state, punctures);
    EXPECT_EQ(static_cast<int>(wire.head), static_cast<int>(end));
    return std::string(suture::text_of(wire.head_holder));
  };
  EXPECT_EQ(holder(ThreadEnd::kFree, -1), "");
  EXPECT_EQ(holder(ThreadEnd::kHeld, 1), "assistant");
  EXPECT_EQ(holder(ThreadEnd::kSwaged, 0), "needle");
  EXPECT_EQ(holder(ThreadEnd::kAnchored, 1), "distal");
}

TEST(SetThread, LendsTheCourseAndKeepsEveryFigure) {
  simulation::ThreadState state;
  state.length_m = 0.45;
  state.tension_n = 0.2;
  state.slack_m = 0.01;
  state.taut = true;
  state.tail = simulation::ThreadEnd::kAnchored;
  state.tail_holder = 0;
  state.course_m = {{1, 2, 3}, {4, 5, 6}};
  state.arc_length_m = {0.0, 0.3};
  state.segment_tension_n = {0.2};
  state.punctures = {{1, {7, 8, 9}, {0, 0, 0}, 0.1, true}};
  std::vector<suture::v1::Puncture> punctures(5);  // of the thread before
  suture::v1::ThreadState wire{};
  set_thread(wire, named_scene(), 0, state, punctures);
  EXPECT_EQ(suture::text_of(wire.thread), "thread");
  EXPECT_EQ(wire.length_m, 0.45);
  EXPECT_EQ(wire.diameter_m, 0.0002);
  EXPECT_EQ(wire.tension_n, 0.2);
  EXPECT_EQ(wire.slack_m, 0.01);
  EXPECT_TRUE(wire.taut);
  EXPECT_EQ(suture::text_of(wire.tail_holder), "proximal");
  ASSERT_EQ(wire.course_m._length, 6U);
  for (int i = 0; i < 6; ++i) EXPECT_EQ(wire.course_m._buffer[i], i + 1);
  ASSERT_EQ(wire.arc_length_m._length, 2U);
  EXPECT_EQ(wire.arc_length_m._buffer[1], 0.3);
  ASSERT_EQ(wire.segment_tension_n._length, 1U);
  ASSERT_EQ(wire.punctures._length, 1U);
  EXPECT_EQ(suture::text_of(wire.punctures._buffer[0].body), "distal");
  EXPECT_EQ(wire.punctures._buffer[0].position_m[2], 9.0);
  EXPECT_EQ(wire.punctures._buffer[0].arc_length_m, 0.1);
  EXPECT_TRUE(wire.punctures._buffer[0].inward);
}

TEST(SetContacts, NamesBothSides) {
  std::vector<simulation::ContactPoint> contacts(2);
  contacts[0].tissue = 0;
  contacts[0].other_tissue = 1;
  contacts[0].position_m = {1, 2, 3};
  contacts[0].force_n = 0.4;
  contacts[0].gap_m = -1e-7;
  contacts[1].tissue = 1;
  contacts[1].needle = 0;
  std::vector<suture::v1::ContactPoint> points(3);
  suture::v1::ContactState wire{};
  set_contacts(wire, named_scene(), contacts, points);
  ASSERT_EQ(wire.points._length, 2U);
  const auto got = suture::span_of(wire.points);
  EXPECT_EQ(suture::text_of(got[0].body), "proximal");
  EXPECT_EQ(suture::text_of(got[0].other), "distal");
  EXPECT_EQ(got[0].position_m[1], 2.0);
  EXPECT_EQ(got[0].normal[2], 1.0);
  EXPECT_EQ(got[0].force_n, 0.4);
  EXPECT_EQ(got[0].gap_m, -1e-7);
  EXPECT_EQ(suture::text_of(got[1].body), "distal");
  EXPECT_EQ(suture::text_of(got[1].other), "needle");
  set_contacts(wire, named_scene(), {}, points);
  EXPECT_EQ(wire.points._length, 0U);
}

TEST(SetQuality, KeepsEveryFigure) {
  simulation::ThreadQuality quality;
  quality.elapsed_s = 1;
  quality.needle_path_m = 2;
  quality.peak_force_n = 3;
  quality.peak_principal_stress_pa = 4;
  quality.gap_start = {0.5, 5};
  quality.gap = {0.6, 6};
  quality.tension_n = 7;
  quality.depth_m = {8, 9};
  quality.spacing_m = {10, 11};
  quality.handovers = 12;
  quality.needle_drops = 13;
  quality.bites = {{1, {1, 2, 3}, {4, 5, 6}, 14, 15, simulation::kNoFigure, 16}};
  std::vector<suture::v1::Bite> bites(3);
  suture::v1::Quality wire{};
  set_quality(wire, named_scene(), 0, quality, bites);
  EXPECT_EQ(suture::text_of(wire.thread), "thread");
  EXPECT_EQ(wire.elapsed_s, 1);
  EXPECT_EQ(wire.needle_path_m, 2);
  EXPECT_EQ(wire.peak_force_n, 3);
  EXPECT_EQ(wire.peak_principal_stress_pa, 4);
  EXPECT_EQ(wire.gap_start_m, 5);  // the largest
  EXPECT_EQ(wire.gap_m, 6);
  EXPECT_EQ(wire.tension_n, 7);
  EXPECT_EQ(wire.bite_depth_mean_m, 8);
  EXPECT_EQ(wire.bite_depth_spread_m, 9);
  EXPECT_EQ(wire.bite_spacing_mean_m, 10);
  EXPECT_EQ(wire.bite_spacing_spread_m, 11);
  EXPECT_EQ(wire.handovers, 12U);
  EXPECT_EQ(wire.needle_drops, 13U);
  ASSERT_EQ(wire.bites._length, 1U);
  const suture::v1::Bite& bite = wire.bites._buffer[0];
  EXPECT_EQ(suture::text_of(bite.body), "distal");
  EXPECT_EQ(bite.entry_m[2], 3);
  EXPECT_EQ(bite.exit_m[0], 4);
  EXPECT_EQ(bite.depth_m, 14);
  EXPECT_EQ(bite.edge_distance_m, 15);
  EXPECT_TRUE(std::isnan(bite.spacing_m));
  EXPECT_EQ(bite.peak_force_n, 16);
}

}  // namespace
}  // namespace sutured::endpoints
