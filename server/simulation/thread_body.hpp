// SPDX-License-Identifier: GPL-3.0-or-later
// One thread: its way through the tissues, what holds it, and its tension.
//
// A thread is a chain of points from tail to head: punctures (and, with `model = "path"`, one point
// per cell between them), jaws, the needle's tail. Points whose place along the thread is known are
// holds: a jaw, a knot at the first puncture, the swage. Two neighbouring holds bound a span, and a
// span is one unilateral row, paper eq. 5 with an absolute length,
//
//     gap = ℓ − Σ ℓ_j(x_j+1 − x_j) ≥ 0,   T ≥ 0,   gap T = 0        0 ≤ T ≤ tension_max_n
//
// linearised at the present positions; T is the tension. The thread runs without friction. The
// length rows alone two-cycle, because their direction turns with the tissue: beside each piece
// stand the rows of T H, its second derivative (thread/segment.hpp),
//
//     e · (Δx_j+1 − Δx_j) + (1 / (T curvature)) λ = 0      e across the piece; all axes where short
//
// with the tension of the last solve, which makes a step a Newton step.
//
//   outside   only pieces outside the tissue pull; a bite counts for a constant length (the paper)
//   path      the tension acts along the bite too, at every cell
//
// A free end follows as thread is drawn from it, and removes a bite when it passes its puncture.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "constraints/complementarity.hpp"
#include "simulation/needle_body.hpp"
#include "simulation/tissue_state.hpp"
#include "simulation/types.hpp"
#include "thread/course.hpp"
#include "thread/segment.hpp"

namespace sutured::simulation {

class ToolBody;

/// Where a jaw found the thread.
struct ThreadGrasp {
  double distance_m = 0.0;
  Vec3 point_m = Vec3::Zero();
  double arc_m = 0.0;    ///< along the thread from its tail
  int bites_before = 0;  ///< bites between it and the tail
  int point = -1;        ///< of the chain, the last before it
};

/// Thread: simulation. Allocates: when a thread's course grows longer than ever before.
class ThreadBody {
 public:
  ThreadBody(const scene::Scene& scene, int index, const TissueState& tissue,
             std::span<const NeedleBody> needles);

  void reset(const TissueState& tissue, std::span<const NeedleBody> needles);
  void serialize(Archive& archive);

  /// Takes over the bites that the needle's tail has passed, gives way to what was pulled, and lays
  /// out the course. Call once a substep after the needles were tracked.
  void update(const TissueState& tissue, std::span<NeedleBody> needles,
              std::span<const ToolBody> tools, double time_s, std::vector<Event>& events);

  /// Moves what holds the thread to where it is now: jaws to their tools.
  void follow(const TissueState& tissue, std::span<const NeedleBody> needles,
              std::span<const ToolBody> tools, double time_s);

  void add_rows(std::span<const NeedleBody> needles, std::span<const ToolBody> tools,
                constraints::ConstraintRows& rows);

  /// Reads tensions back, and lets the thread slip where a jaw holds it no longer.
  void commit(const constraints::ConstraintRows& rows, std::span<const double> lambda,
              std::span<const double> gap_m, std::span<const constraints::RowState> states,
              double time_s, std::vector<Event>& events);

  /// Finds the nearest point of the drawn course within `radius_m`.
  [[nodiscard]] std::optional<ThreadGrasp> nearest(const Vec3& point_m, double radius_m) const;
  void grip(int tool, const ThreadGrasp& grasp);
  void release(int tool);
  /// False once it has slipped through the jaw, off its end.
  [[nodiscard]] bool held_by(int tool) const;

  [[nodiscard]] const scene::Thread& description() const { return description_; }
  [[nodiscard]] double tension_n() const;
  [[nodiscard]] bool world_changed() const { return world_changed_; }
  void clear_world_changed() { world_changed_ = false; }
  /// Largest change of a length that the program asks for between two times, per piece.
  [[nodiscard]] double programmed_motion_m(double from_s, double to_s) const;
  void report(const TissueState& tissue, ThreadState& state) const;

 private:
  enum class Kind : std::uint8_t { kTissue, kTool, kNeedle };
  /// A point of the chain, and the piece from it to the next.
  struct Point {
    Kind kind = Kind::kTissue;
    thread::MaterialPoint at;
    int body = -1;  ///< tissue, tool or needle
    Vec3 position_m = Vec3::Zero();
    bool hold = false;
    double arc_m = 0.0;                                ///< of a hold, from the tail
    double spare_before_m = 0.0, spare_after_m = 0.0;  ///< of a jaw
    bool puncture = false;
    bool inward = false;  ///< of a puncture: from tail to head it enters
    int bites_before = 0;
    bool inside_next = false;     ///< the piece to the next point lies in tissue
    bool pulls_next = true;       ///< that piece carries tension to its ends
    double fixed_length_m = 0.0;  ///< what it counts for where it does not
  };
  struct Span {
    int first = 0, last = 0;  ///< points of the chain
    double length_m = 0.0;    ///< ℓ
    std::uint64_t key = 0;
    int row = -1;
    int weakest = -1;  ///< point of the chain whose jaw bounds the tension, or −1
    double tension_n = 0.0, overlength_m = 0.0;
    double compliance_m_per_n = 0.0;  ///< of its row: the grips of its jaws
    bool taut = false, clamped = false;
  };
  struct Hold {
    int tool = -1;
    double arc_m = 0.0;
    int bites_before = 0;
    bool slip_told = false;
    /// What the thread on either side is longer than the places of its ends say: what its grip
    /// gave way when it closed on a taut thread, or the least that a piece counts for.
    double spare_before_m = 0.0, spare_after_m = 0.0;
  };
  /// A point of the drawn course.
  struct Drawn {
    Vec3 position_m;
    double arc_m;
    int bites_before;
    int point;  ///< of the chain, from which the piece to the next leads on; −1: to its first
  };

  void take_path(const TissueState& tissue, NeedleBody& needle);
  void drop_bite(bool at_tail, std::span<NeedleBody> needles);
  void build_chain(const TissueState& tissue, std::span<const NeedleBody> needles,
                   std::span<const ToolBody> tools, double time_s);
  void feed(const TissueState& tissue, std::span<NeedleBody> needles,
            std::span<const ToolBody> tools, double time_s, std::vector<Event>& events);
  void draw();
  [[nodiscard]] double counted_length_m(int first, int last) const;
  [[nodiscard]] double held_length_m(int first, int last) const;
  [[nodiscard]] const Span* span_from(int point) const;
  [[nodiscard]] double program_length_m(double time_s) const;
  bool tells_of_slip(int tool);
  void slip(int tool, double distance_m);
  void touch(constraints::ConstraintRows& rows, constraints::Row& row, const Point& point,
             const Vec3& gradient, std::span<const NeedleBody> needles,
             std::span<const ToolBody> tools, double& tissue_part) const;
  [[nodiscard]] std::size_t bite_count() const { return bites_.size() + path_bites_.size(); }
  [[nodiscard]] const thread::Bite& bite(std::size_t i) const {
    return i < bites_.size() ? bites_[i] : path_bites_[i - bites_.size()];
  }

  const scene::Scene* scene_;
  int index_;
  scene::Thread description_;
  int needle_ = -1;
  std::vector<thread::Bite> bites_;       ///< that it started with
  std::vector<thread::Bite> path_bites_;  ///< that its needle made
  std::vector<Hold> holds_;               ///< jaws, from tail to head
  std::vector<Point> chain_;
  std::vector<Span> spans_, previous_spans_;
  std::vector<Drawn> drawn_;
  double tail_out_m_ = 0.0, head_out_m_ = 0.0;  ///< before the first and behind the last puncture
  bool ends_known_ = false;     ///< the free ends' lengths were set when a first bite was made
  double rest_length_m_ = 0.0;  ///< of the counted pieces, for a thread without ends
  Vec3 hanging_ = -Vec3::UnitZ();
  bool world_changed_ = false;
};

}  // namespace sutured::simulation
