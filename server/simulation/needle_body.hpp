// SPDX-License-Identifier: GPL-3.0-or-later
// One needle: where it is, which cells it couples to, and what its tip touches.
//
// Its twist η and slide σ are unknowns of a step (paper eq. 2, D·S):
//
//     sticking row   gap = C x + ε λ − s(α) − J (η − s σ)      (eq. 3)   ε = 0.02 m² / (E ℓ)
//     viscous slide  c L σ / dt = −k · λ                        k = −J s
//
// so a held needle has a slide compliance β = dt / (c L): the axial force is the friction at the
// speed it slides with, and the work of slide and deformation is shared out consistently. With
// `slide = "least_squares"` σ is given before the solve instead and β = 0.
//
// The tip, outside: a unilateral row against the nearest surface, and while it presses, two
// tangential rows to the material point it stands on, which slip beyond the friction cone. The
// normal row is bounded by what the puncture force leaves it along the axis; at that bound, or when
// the whole axial force passes it, the tip goes in. Inside, the same rows hold it before
// the wall ahead, but without a cone: a point that has gone through tissue does not skid along its
// far side.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "constraints/complementarity.hpp"
#include "needle/path.hpp"
#include "simulation/shaft_contact.hpp"
#include "simulation/tissue_state.hpp"

namespace sutured::simulation {

using constraints::Mat6;
using constraints::Vec6;

/// What the tip stands against.
struct TipContact {
  enum class Side : std::uint8_t { kNone, kOutside, kInside };
  Side side = Side::kNone;
  needle::BoundaryPoint at;
  Vec3 normal = Vec3::UnitZ();  ///< outward, of the surface
  bool pressing = false;        ///< the normal row carried force in the last solve
  bool slipping = false;        ///< the tangential rows are at the cone in this solve
  Vec3 slip_direction = Vec3::Zero();
  double cone_n = 0.0;                  ///< bound of the tangential rows while slipping
  int first_row = -1, rows = 0;         ///< in the present ConstraintRows: normal, then tangents
  Vec3 tangent_force_n = Vec3::Zero();  ///< on the tissue, last solve
  double normal_force_n = 0.0;
  double axial_force_n = 0.0;  ///< against the tip's advance
};

class NeedleBody {
 public:
  NeedleBody(const scene::Scene& scene, int index);

  void reset();
  void serialize(Archive& archive);

  /// Starts a substep: chooses the slide compliance and, by least squares, slides towards `target`.
  void begin(const TissueState& tissue, double dt_s, bool held,
             const std::optional<scene::Pose>& target);

  /// Looks for what tip and shaft may meet within `reach_m`.
  void find_contact(const TissueState& tissue, double reach_m);

  /// Adds sticking and tip rows.
  void add_rows(const TissueState& tissue, constraints::ConstraintRows& rows);

  /// Reads the multipliers back. Returns false if the tip slips or the needle's static friction
  /// gives way and the rows must be solved again.
  bool read(const constraints::ConstraintRows& rows, std::span<const double> lambda,
            bool may_revise);

  /// Takes the solved twist and slide; the path follows in `track`.
  void commit(const constraints::ConstraintRows& rows, std::span<const double> lambda,
              std::span<const constraints::RowState> states);

  /// Lets the path follow the last committed motion in the refreshed tissue.
  void track(const TissueState& tissue, double time_s, std::vector<Event>& events);

  /// Lists where it passes surfaces, from tip to tail. Allocates: when there are more than
  /// `punctures` has room for.
  void report_punctures(const TissueState& tissue, std::vector<NeedlePuncture>& punctures) const;

  [[nodiscard]] const constraints::NeedleMobility& mobility() const { return mobility_; }
  [[nodiscard]] const scene::Pose& pose() const { return pose_; }
  [[nodiscard]] const needle::Curve& curve() const { return curve_; }
  [[nodiscard]] const needle::Path& path() const { return path_; }
  [[nodiscard]] const TipContact& tip() const { return tip_; }
  [[nodiscard]] const ShaftContact& shaft() const { return shaft_; }
  [[nodiscard]] const scene::Needle& description() const { return description_; }
  [[nodiscard]] bool slides_freely() const {
    return held_ && !least_squares() && path_.embedded_length_m() > 0.0;
  }
  /// c L (N·s/m): friction against the slide's speed, as of this step; 0 where it is not viscous.
  [[nodiscard]] double slide_drag_n_s_per_m() const {
    return slides_freely() ? embedded_friction_ : 0.0;
  }
  [[nodiscard]] bool least_squares() const {
    return description_.slide == scene::SlideRule::kLeastSquares;
  }
  [[nodiscard]] bool world_changed() const { return world_changed_; }
  void clear_world_changed() { world_changed_ = false; }
  /// Jacobian row of a point of the needle (world) along `direction`: direction · (t + ω × r).
  [[nodiscard]] Vec6 jacobian(const Vec3& point_m, const Vec3& direction) const;
  /// Gradient of the least-squares slide with respect to a twist about `origin_m`: σ = gᵀ ξ.
  [[nodiscard]] Vec6 least_squares_gradient(const Vec3& origin_m) const;
  /// Forgets the oldest bite, which its thread has left. Precondition: the needle has left it.
  void forget_first_bite() { path_.drop_first_bite(); }
  void set_holder(int tool) { holder_ = tool; }
  [[nodiscard]] int holder() const { return holder_; }

 private:
  void find_tip_contact(const TissueState& tissue, double reach_m);
  void meet(const needle::TissueView& view, const needle::BoundaryPoint& point);
  void puncture(const TissueState& tissue, double time_s, std::vector<Event>& events);

  const scene::Scene* scene_;
  int index_;
  scene::Needle description_;
  needle::Curve curve_;
  needle::Path path_;
  scene::Pose pose_;
  constraints::NeedleMobility mobility_;
  TipContact tip_;
  ShaftContact shaft_;
  int holder_ = -1;
  bool held_ = false;
  bool static_slip_ = false;  ///< nobody holds it and its static friction gave way
  double static_slip_sign_ = 0.0;
  double static_limit_n_ = 0.0;
  double embedded_friction_ = 0.0;  ///< Σ c ℓ, N s/m
  double axial_force_n_ = 0.0;      ///< −k · λ
  int first_cell_row_ = 0, cell_rows_ = 0;
  double pending_slide_m_ = 0.0;  ///< committed, not yet tracked
  bool pending_ = false;
  bool pending_puncture_ = false, pending_exit_ = false;
  bool began_pressing_ = false;
  bool world_changed_ = false;
  std::vector<double> s_, weight_;  ///< of the least-squares slide
  int tip_tissue_ = 0;              ///< of `tip_.at`
  double rows_compliance_ = 0.0;    ///< ε of the tip's rows
};

}  // namespace sutured::simulation
