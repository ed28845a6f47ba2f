// SPDX-License-Identifier: GPL-3.0-or-later
// What crosses the border of a simulation: tool poses in, responses and events out.
// World frame and SI units throughout; rigid motions are twists (translation,
// rotation vector) in that order, wrenches (force, torque) likewise.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace sutured {
class Archive;
}

namespace sutured::simulation {

using Vec3 = Eigen::Vector3d;
using Vec6 = Eigen::Matrix<double, 6, 1>;
using Mat6 = Eigen::Matrix<double, 6, 6>;

/// Where a tool is at the end of a step. A tool that is absent holds nothing and feels nothing.
struct ToolInput {
  bool present = false;
  Vec3 position_m = Vec3::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  double jaw = 0.0;  ///< 0 open … 1 closed
};

/// What a jaw holds.
enum class HeldKind : std::uint8_t { kNothing, kNeedle, kTissue, kThread };

/// The thing in a jaw: one of the scene's needles, tissues or threads.
struct HeldThing {
  HeldKind kind = HeldKind::kNothing;
  int index = -1;  ///< into the scene's list of that kind
};

/// Unilateral rows that may still switch while a tool moves, all else condensed out:
///
///     gap(ξ) = S λ − q − Ĵ ξ,   0 ≤ λ ≤ λ_max,   gap ⟂ λ
///     w(ξ)   = w_0 − A_0 ξ − Ĵᵀ λ
///
///   S  m × m  m/N   Ĵ  m × 6  (tool's twist)   q  m  m
///
/// Storage is inline, for up to kRowsMax rows: nothing allocates.
struct CondensedProblem {
  static constexpr int kRowsMax = 64;
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, kRowsMax, 1>;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kRowsMax, kRowsMax>
      compliance_m_per_n;                                                           ///< S
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::ColMajor, kRowsMax, 6> jacobian;  ///< Ĵ
  Vector offset_m;                                                                  ///< q
  Vector multiplier_n;      ///< λ at ξ = 0
  Vector multiplier_max_n;  ///< λ_max, +inf where unbounded
  /// The row whose multiplier λ_max follows with the slope μ: its normal force. μ = 0: fixed.
  std::array<int, kRowsMax> bound_row{};
  Vector bound_slope;
  int frozen_rows = 0;  ///< rows beyond kRowsMax, farthest from switching, kept on their side
};

/// How a tool's response depends on the small motion ξ_b of another one since its own reference:
///
///     w −= stiffness ξ_b,   gap −= jacobian ξ_b
struct ToolCoupling {
  int tool = -1;        ///< index of the other one
  ToolInput reference;  ///< its pose in this step
  Mat6 stiffness = Mat6::Zero();
  Vec6 slide_gradient = Vec6::Zero();  ///< of the needle that the tool itself holds
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::ColMajor, CondensedProblem::kRowsMax, 6> jacobian;
};

/// What a tool feels, and how that changes with its small motion ξ since `reference`:
///
///     w(ξ) = wrench − stiffness ξ        while the active set holds
///
/// at the tool's origin, world axes, force on the tool (the hand). `stiffness` has
/// the slide removed.
struct ToolResponse {
  ToolInput reference;
  Vec6 wrench = Vec6::Zero();               ///< N, N·m
  Mat6 stiffness = Mat6::Zero();            ///< N/m, N, N·m/rad
  Vec6 bilateral_wrench = Vec6::Zero();     ///< w_0: with every row of `condensed` at λ = 0
  Mat6 bilateral_stiffness = Mat6::Zero();  ///< A_0
  CondensedProblem condensed;
  static constexpr int kOthersMax = 7;
  int other_count = 0;
  std::array<ToolCoupling, kOthersMax> others;  ///< tools that are felt through tissue or needle
  Vec6 slide_twist = Vec6::Zero();              ///< s, unit slide of the needle held; zero if none
  double slide_friction_n = 0.0;                ///< f along s
  double slide_drag_n_s_per_m = 0.0;            ///< c, f = −c dσ/dt; zero: not viscous
  Vec6 slide_gradient =
      Vec6::Zero();              ///< g = A s / κ of A before the slide's removal: P = I − s gᵀ
  double slide_stiffness = 0.0;  ///< κ = sᵀ A s of the same; zero: nothing slides
  /// M = Σ r fᵀ (N·m) over the bilateral forces f on the tool at arms r from its origin;
  /// with it the haptic model turns torques with the tool. Zero where arms do not matter.
  Eigen::Matrix3d arm_moment = Eigen::Matrix3d::Zero();
  HeldThing held;
  bool touching = false;       ///< false: the wrench is exactly zero
  bool world_changed = false;  ///< a contact, puncture, grasp or release in this step
};

enum class EventKind : std::uint8_t {
  kGrasp,
  kRelease,
  kContact,
  kPuncture,
  kExit,
  kGripSlip,
  kLimit,           ///< a length or a force was clamped
  kSolverResidual,  ///< the multipliers miss their conditions
  kContactLost,
  kTaut,
  kSlack,
  kUnthread,  ///< an end of a thread passed a puncture: that bite is gone
  kInverted   ///< tets are inside out, more than before; `subject` is the tissue of the first,
              ///< `position_m` its centre, `force_n` their number
};

inline constexpr std::size_t kEventKinds = static_cast<std::size_t>(EventKind::kInverted) + 1;

/// Something that happened in a step.
struct Event {
  EventKind kind{};
  double time_s = 0.0;
  std::string subject;  ///< the tool or needle it happened to
  std::string object;   ///< the tissue, needle or tool on the other side
  Vec3 position_m = Vec3::Zero();
  double force_n = 0.0;  ///< at the moment of the event
};

/// Where a needle passes a tissue's surface.
struct NeedlePuncture {
  int tissue = -1;                 ///< index into Scene::tissues
  Vec3 position_m = Vec3::Zero();  ///< of the hole, on the surface
  double arc_length_m = 0.0;       ///< along the needle from its tip
  bool inward = false;             ///< enters the tissue, going from tip to tail
};

/// A needle as viewers see it.
struct NeedleState {
  Vec3 position_m = Vec3::Zero();  ///< of the needle's frame
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
  int holder = -1;  ///< index of a tool that grips it, or −1
  int active_cells = 0;
  double embedded_length_m = 0.0;
  double tip_force_n = 0.0;
  bool tip_inside = false;
  /// From tip to tail, where the tissue was brought to last; the way of the thread behind the tail
  /// has none.
  std::vector<NeedlePuncture> punctures;

  /// Leaves the punctures out: they follow from the needle's path and the tissue.
  void serialize(Archive& archive);
};

/// What rules an end of a thread.
enum class ThreadEnd : std::uint8_t { kFree, kSwaged, kHeld, kAnchored };

/// Where a thread passes a tissue's surface.
struct ThreadPuncture {
  int tissue = -1;  ///< index into Scene::tissues
  Vec3 position_m = Vec3::Zero();
  Vec3 rest_position_m = Vec3::Zero();
  double arc_length_m = 0.0;  ///< along the thread from its head
  bool inward = false;        ///< enters the tissue, going from head to tail
};

/// A thread as viewers see it: from its head (where the needle is, or was) to its tail.
struct ThreadState {
  double length_m = 0.0;   ///< of the whole thread
  double tension_n = 0.0;  ///< largest along it
  double slack_m = 0.0;    ///< length to spare between what holds it; 0: taut
  bool taut = false;
  /// Largest amount by which a span between two holds is longer than its thread (0 once settled).
  double overlength_m = 0.0;
  ThreadEnd head = ThreadEnd::kFree, tail = ThreadEnd::kFree;
  int head_holder = -1, tail_holder = -1;  ///< tool (kHeld), needle (kSwaged) or tissue (kAnchored)
  std::vector<Vec3> course_m;              ///< what to draw; the free part straight, or sagging
  std::vector<double> arc_length_m;        ///< per point of the course
  std::vector<double> segment_tension_n;   ///< per pair of neighbours
  std::vector<ThreadPuncture> punctures;
};

/// A pair in contact: of two surfaces, or of a needle's shaft and a surface.
struct ContactPoint {
  Vec3 position_m = Vec3::Zero();
  Vec3 normal = Vec3::UnitZ();  ///< out of `tissue`
  double force_n = 0.0;
  double gap_m = 0.0;
  int tissue = -1;
  int other_tissue = -1;  ///< −1 where the other side is a needle
  int needle = -1;
};

/// One line of steps.csv, and where the time went.
struct StepReport {
  std::uint64_t step = 0;
  double time_s = 0.0;
  int substeps = 0;
  int rows = 0;
  int active_unilateral_rows = 0;
  int contacts = 0;
  double complementarity_residual = 0.0;  ///< dimensionless: see SolveReport::residual
  int inverted_tets = 0;  ///< most at once, in the equilibria whose displacements are known
  int contact_pairs = 0;  ///< in reach, of which `contacts` carry force
  std::int64_t track_ns = 0, contact_ns = 0, assemble_ns = 0, solve_ns = 0, backward_ns = 0,
               model_ns = 0;
};

}  // namespace sutured::simulation
