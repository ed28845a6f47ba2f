// SPDX-License-Identifier: GPL-3.0-or-later
// One tool: a driver that grasps through a compliant grip, or a probe that pushes.
//
// A closing jaw grasps the nearest thing within its capture radius: a needle (six rows), a
// point of a tissue's surface (three), or a point of a thread, whose span rows it then feels
// (thread_body.hpp). With the tool's point a and the thing's point q,
//
//     gap = ε λ − (q − a),   ε = 1 / grip stiffness        force on the tool = λ
//
// so each hand feels its own grip, and two hands may hold one needle without a fight. Beyond
// `grip_force_max_n` the grip slips: its rows are bounded along the force and solved again, and
// the tool's point follows, a = q − ε λ. A grip starts without force: a = q.
//
// A probe is a sphere in unilateral contact with every feature of the surface within reach.
#pragma once

#include <span>
#include <vector>

#include "constraints/complementarity.hpp"
#include "simulation/needle_body.hpp"
#include "simulation/tissue_state.hpp"

namespace sutured::simulation {

class ThreadBody;

class ToolBody {
 public:
  ToolBody(const scene::Scene& scene, int index);

  void reset();
  void serialize(Archive& archive);

  /// Moves to `input`; opens and closes the jaw. Call once a substep, tissue refreshed.
  void move(const ToolInput& input, const TissueState& tissue, std::span<NeedleBody> needles,
            std::span<ThreadBody> threads, double time_s, std::vector<Event>& events);

  /// Adds the rows of its grip or of its contacts.
  void add_rows(const TissueState& tissue, std::span<NeedleBody> needles, double reach_m,
                constraints::ConstraintRows& rows);

  /// Reads the multipliers back. Returns false if the grip slips and the rows must be solved again.
  bool read(const constraints::ConstraintRows& rows, std::span<const double> lambda,
            bool may_revise);

  /// After the solve: lets a slipping grip's point follow. Needles have moved already.
  void commit(const TissueState& tissue, std::span<NeedleBody> needles, double time_s,
              std::vector<Event>& events);

  /// Where the needle in the grip would be if the grip were rigid; none if it holds no needle.
  [[nodiscard]] std::optional<scene::Pose> needle_target(int needle) const;

  [[nodiscard]] const ToolInput& input() const { return input_; }
  /// The tension at which a thread slips through the jaw: less where two ends of it pull.
  [[nodiscard]] double thread_tension_max_n() const { return thread_tension_max_n_; }
  [[nodiscard]] int needle() const { return held_ == Held::kNeedle ? needle_ : -1; }
  [[nodiscard]] bool holds() const { return held_ != Held::kNothing; }
  [[nodiscard]] const scene::Tool& description() const { return description_; }
  /// The point of the jaw that holds something, in the world.
  [[nodiscard]] Vec3 grip_point_m() const { return to_world(anchor_tool_m_); }
  /// Jacobian row of a point that moves with the tool along `direction`: direction · (t + ω × r).
  [[nodiscard]] Vec6 jacobian(const Vec3& point_m, const Vec3& direction) const;
  [[nodiscard]] HeldThing held(const TissueState& tissue) const;
  [[nodiscard]] const Vec6& wrench() const { return wrench_; }
  [[nodiscard]] const Eigen::Matrix3d& arm_moment() const { return arm_moment_; }
  [[nodiscard]] bool touching() const { return touching_; }
  [[nodiscard]] bool world_changed() const { return world_changed_; }
  void clear_world_changed() { world_changed_ = false; }
  [[nodiscard]] int contacts() const { return contacts_; }

 private:
  enum class Held : std::uint8_t { kNothing, kNeedle, kTissue, kThread };
  [[nodiscard]] Vec3 to_world(const Vec3& local) const {
    return input_.position_m + input_.orientation * local;
  }
  [[nodiscard]] Vec3 to_tool(const Vec3& world) const {
    return input_.orientation.conjugate() * (world - input_.position_m);
  }
  void grasp(const TissueState& tissue, std::span<NeedleBody> needles,
             std::span<ThreadBody> threads, double time_s, std::vector<Event>& events);
  void release(const TissueState& tissue, std::span<NeedleBody> needles,
               std::span<ThreadBody> threads, double time_s, std::vector<Event>& events);
  [[nodiscard]] std::string held_name(const TissueState& tissue,
                                      std::span<NeedleBody> needles) const;
  void add_probe_rows(const TissueState& tissue, double reach_m, constraints::ConstraintRows& rows);

  const scene::Scene* scene_;
  int index_;
  scene::Tool description_;
  ToolInput input_;
  bool closed_ = false;
  Held held_ = Held::kNothing;
  int needle_ = -1;
  int thread_ = -1;
  double needle_s_ = 0.0;  ///< where on the needle's axis the jaw holds it
  needle::BoundaryPoint tissue_point_;
  Vec3 anchor_tool_m_ = Vec3::Zero();  ///< a, in the tool's frame
  Eigen::Quaterniond needle_in_tool_ = Eigen::Quaterniond::Identity();
  bool slipping_force_ = false, slipping_torque_ = false;
  Vec3 force_axis_ = Vec3::UnitX(), torque_axis_ = Vec3::UnitX();
  Vec3 force_n_ = Vec3::Zero(),
       torque_nm_ = Vec3::Zero();  ///< of the grip on the held thing's rows
  bool slip_reported_ = false;
  double thread_tension_max_n_ = 0.0;
  int first_row_ = 0, rows_ = 0;
  int contacts_ = 0;
  Vec6 wrench_ = Vec6::Zero();
  Eigen::Matrix3d arm_moment_ = Eigen::Matrix3d::Zero();
  bool touching_ = false, world_changed_ = false;
};

}  // namespace sutured::simulation
