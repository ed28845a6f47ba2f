// SPDX-License-Identifier: GPL-3.0-or-later
#include "simulation/thread_body.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "simulation/tool_body.hpp"

namespace sutured::simulation {
namespace {

using constraints::Bounds;
using constraints::ConstraintRows;
using thread::Bite;
using thread::MaterialPoint;
using thread::segment_length;

// Compliance of a length row: far below the tissue's, it keeps two threads on one way apart.
constexpr double kLengthCompliance_m_per_n = 1e-9;
// Below this tension a piece has no stiffness across worth a row.
constexpr double kTensionFloor_n = 1e-6;
// Taut is said above this tension, slack at none.
constexpr double kTaut_n = 1e-3;
// A step shortens each piece by at most this: beyond it the linearised length is far off.
constexpr double kShorteningMax_m = 0.5e-3;
constexpr int kSagPieces = 12;
// Sag is drawn no deeper than this.
constexpr double kSagMax_m = 0.02;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

}  // namespace

ThreadBody::ThreadBody(const scene::Scene& scene, int index, const TissueState& tissue,
                       std::span<const NeedleBody> needles)
    : scene_(&scene), index_(index), description_(scene.threads[at(index)]) {
  for (std::size_t n = 0; n < scene.needles.size(); ++n)
    if (scene.needles[n].name == description_.needle) needle_ = static_cast<int>(n);
  if (!scene.gravity_m_per_s2.isZero()) hanging_ = scene.gravity_m_per_s2.normalized();
  reset(tissue, needles);
}

void ThreadBody::reset(const TissueState& tissue, std::span<const NeedleBody> needles) {
  bites_.clear();
  path_bites_.clear();
  holds_.clear();
  spans_.clear();
  const std::span<const Vec3> rest = tissue.model().vertices_m;
  const auto puncture = [&](const scene::Bite& place) {
    MaterialPoint point;
    point.count = 3;
    const std::int32_t base = tissue.bodies()[at(place.tissue)].first_vertex;
    for (std::size_t i = 0; i < 3; ++i) {
      point.vertices[i] = base + place.vertices[i];
      point.weight[static_cast<Eigen::Index>(i)] = place.barycentric[static_cast<Eigen::Index>(i)];
    }
    return point;
  };
  for (std::size_t i = 0; i + 1 < description_.punctures.size(); i += 2) {
    Bite bite;
    bite.tissue = description_.punctures[i].tissue;
    bite.entry = puncture(description_.punctures[i]);
    bite.exit = puncture(description_.punctures[i + 1]);
    const Vec3 from = bite.entry.position(rest), to = bite.exit.position(rest);
    bite.inner = thread::straight_course(rest, tissue.model().tets, from, to);
    bite.inside_length_m = (to - from).norm();
    bites_.push_back(std::move(bite));
  }
  tail_out_m_ = description_.tail == scene::ThreadTail::kFree ? description_.tail_length_m : 0.0;
  head_out_m_ = description_.head == scene::ThreadHead::kFree ? description_.tail_length_m : 0.0;
  ends_known_ = !bites_.empty();
  world_changed_ = true;
  rest_length_m_ = 0.0;
  build_chain(tissue, needles, {}, 0.0);
  if (!chain_.empty()) rest_length_m_ = counted_length_m(0, static_cast<int>(chain_.size()) - 1);
  if (description_.ends == scene::ThreadEnds::kNone)
    for (Span& span : spans_) span.length_m = program_length_m(0.0);
  draw();
}

void ThreadBody::serialize(Archive& archive) {
  // Given by the scene: scene … needle, hanging. Of one call: previous_spans.
  auto& [scene, index, description, needle, bites, path_bites, holds, chain, spans, previous_spans,
         drawn, tail_out, head_out, ends_known, rest_length, hanging, world_changed] = *this;
  archive(bites, path_bites, holds, chain, spans, drawn, tail_out, head_out, ends_known,
          rest_length, world_changed);
}

/// The cells that the needle's tail has left, as bites.
void ThreadBody::take_path(const TissueState& tissue, NeedleBody& needle) {
  const needle::TissueView view = tissue.view();
  std::size_t count = 0;
  bool within = false;
  for (const needle::Cell& cell : needle.path().cells()) {
    if (cell.entered.triangle >= 0) within = false;
    if (cell.s_back >= 0.0) break;
    if (cell.entered.triangle >= 0) {
      within = true;
      const bool known = count < path_bites_.size();
      if (!known) path_bites_.emplace_back();
      Bite& bite = path_bites_[count++];
      bite.tissue = tissue.tissue_of_tet(cell.tet);
      bite.entry = thread::on_surface(*view.surface, cell.entered);
      bite.inner.clear();
      if (!known) bite.open = true;
      if (!known) world_changed_ = true;
    }
    if (!within) continue;  // the front of a bite whose entry was dropped
    Bite& bite = path_bites_[count - 1];
    if (cell.active_length_m == 0.0)
      bite.inner.push_back(thread::in_tet(view.tets[at(cell.tet)], cell.barycentric));
    const bool passed = cell.left.triangle >= 0 && cell.s_front < 0.0;
    if (passed) {
      bite.exit = thread::on_surface(*view.surface, cell.left);
      if (bite.open)
        bite.inside_length_m =
            (bite.exit.position(view.positions_m) - bite.entry.position(view.positions_m)).norm();
      bite.open = false;
    } else {
      bite.open = true;
    }
  }
  path_bites_.resize(count);
}

void ThreadBody::build_chain(const TissueState& tissue, std::span<const NeedleBody> needles,
                             std::span<const ToolBody> tools, double time_s) {
  chain_.clear();
  const auto positions = tissue.positions_m();
  const bool path = description_.model == scene::ThreadModel::kPath;
  const bool ends = description_.ends == scene::ThreadEnds::kHeld;
  const auto add_holds = [&](int bites_before) {
    for (const Hold& hold : holds_) {
      if (hold.bites_before != bites_before || at(hold.tool) >= tools.size()) continue;
      Point point;
      point.kind = Kind::kTool;
      point.body = hold.tool;
      point.position_m = tools[at(hold.tool)].grip_point_m();
      point.hold = true;
      point.arc_m = hold.arc_m;
      point.spare_before_m = hold.spare_before_m;
      point.spare_after_m = hold.spare_after_m;
      point.bites_before = bites_before;
      chain_.push_back(point);
    }
  };
  const auto add_point = [&](const MaterialPoint& material, const Bite& bite, int before) {
    Point point;
    point.at = material;
    point.body = bite.tissue;
    point.position_m = material.position(positions);
    point.bites_before = before;
    chain_.push_back(point);
  };
  const int count = static_cast<int>(bite_count());
  for (int b = 0; b < count; ++b) {
    add_holds(b);
    const Bite& now = bite(at(b));
    const std::size_t first = chain_.size();
    add_point(now.entry, now, b);
    chain_.back().puncture = chain_.back().inward = true;
    // The knot, at arc 0. A jaw that holds the thread before it has the tail in hand.
    if (chain_.size() == 1 && ends && description_.tail == scene::ThreadTail::kAnchored)
      chain_.back().hold = true;
    if (path)
      for (const MaterialPoint& inner : now.inner) add_point(inner, now, b);
    if (!now.open) {
      add_point(now.exit, now, b);
      chain_.back().puncture = true;
    }
    // The pieces inside, up to the exit; of an open bite up to the needle's tail.
    const std::size_t last = now.open ? chain_.size() : chain_.size() - 1;
    for (std::size_t i = first; i < last; ++i) {
      chain_[i].inside_next = true;
      if (path || now.open) continue;
      chain_[i].pulls_next = false;
      chain_[i].fixed_length_m = ends ? now.inside_length_m : 0.0;
    }
  }
  add_holds(count);
  if (ends && description_.head == scene::ThreadHead::kSwaged && needle_ >= 0 &&
      at(needle_) < needles.size()) {
    const NeedleBody& needle = needles[at(needle_)];
    Point point;
    point.kind = Kind::kNeedle;
    point.body = needle_;
    point.position_m = needle.curve().point(needle.pose(), 0.0);
    point.hold = true;
    point.arc_m = description_.length_m;
    point.bites_before = count;
    chain_.push_back(point);
  }

  previous_spans_.swap(spans_);
  spans_.clear();
  const auto add_span = [&](int first, int last, double length_m, std::uint64_t name) {
    Span span;
    span.first = first;
    span.last = last;
    span.length_m = length_m;
    span.key = (std::uint64_t{1} << 62) | (static_cast<std::uint64_t>(index_) << 32) | name;
    for (const Span& before : previous_spans_)
      if (before.key == span.key) {
        span.tension_n = before.tension_n;
        span.taut = before.taut;
        span.clamped = before.clamped;
        span.compliance_m_per_n = before.compliance_m_per_n;
      }
    spans_.push_back(span);
  };
  if (!ends) {
    if (chain_.size() > 1)
      add_span(0, static_cast<int>(chain_.size()) - 1, program_length_m(time_s), 1);
    return;
  }
  int before = -1;
  for (int i = 0; i < static_cast<int>(chain_.size()); ++i) {
    if (!chain_[at(i)].hold) continue;
    // A span is named after what holds it on the head's side.
    const auto name =
        chain_[at(i)].kind == Kind::kTool ? 16 + static_cast<std::uint64_t>(chain_[at(i)].body) : 2;
    if (before >= 0) add_span(before, i, held_length_m(before, i), name);
    before = i;
  }
}

/// Length of the thread between two holds.
double ThreadBody::held_length_m(int first, int last) const {
  const Point &from = chain_[at(first)], &to = chain_[at(last)];
  return to.arc_m - from.arc_m + from.spare_after_m + to.spare_before_m;
}

double ThreadBody::counted_length_m(int first, int last) const {
  double sum = 0.0;
  for (int i = first; i < last; ++i) {
    const Point& point = chain_[at(i)];
    sum += point.pulls_next
               ? segment_length(chain_[at(i + 1)].position_m - point.position_m).length_m
               : point.fixed_length_m;
  }
  return sum;
}

double ThreadBody::program_length_m(double time_s) const {
  const auto& program = description_.length_program;
  if (program.empty()) return rest_length_m_;
  if (time_s <= program.front().time_s) return program.front().length_m;
  for (std::size_t i = 1; i < program.size(); ++i) {
    if (time_s > program[i].time_s) continue;
    const double share =
        (time_s - program[i - 1].time_s) / (program[i].time_s - program[i - 1].time_s);
    return std::lerp(program[i - 1].length_m, program[i].length_m, share);
  }
  return program.back().length_m;
}

double ThreadBody::programmed_motion_m(double from_s, double to_s) const {
  if (description_.length_program.empty() || chain_.size() < 2) return 0.0;
  int pieces = 0;
  for (const Point& point : chain_) pieces += point.pulls_next;
  return std::abs(program_length_m(to_s) - program_length_m(from_s)) / std::max(1, pieces - 1);
}

void ThreadBody::drop_bite(bool at_tail, std::span<NeedleBody> needles) {
  if (at_tail) {
    if (!bites_.empty()) {
      bites_.erase(bites_.begin());
    } else {
      path_bites_.erase(path_bites_.begin());
      if (needle_ >= 0) needles[at(needle_)].forget_first_bite();
    }
    for (Hold& hold : holds_) hold.bites_before = std::max(0, hold.bites_before - 1);
  } else {
    // A free head has no needle: its bites are all its own.
    if (!bites_.empty()) bites_.pop_back();
    for (Hold& hold : holds_)
      hold.bites_before = std::min(hold.bites_before, static_cast<int>(bite_count()));
  }
}

/// Draws thread from free ends, and back out of them, as the holds need it; unthreads what an end
/// has passed.
void ThreadBody::feed(const TissueState& tissue, std::span<NeedleBody> needles,
                      std::span<const ToolBody> tools, double time_s, std::vector<Event>& events) {
  if (description_.ends == scene::ThreadEnds::kNone) return;
  const bool free_tail = description_.tail == scene::ThreadTail::kFree,
             free_head = description_.head == scene::ThreadHead::kFree;
  while (bite_count() > 0) {
    const auto is_puncture = [](const Point& point) { return point.puncture; };
    const auto is_hold = [](const Point& point) { return point.hold; };
    const auto first = std::find_if(chain_.begin(), chain_.end(), is_puncture);
    const auto last = std::find_if(chain_.rbegin(), chain_.rend(), is_puncture).base() - 1;
    const auto counted = [&](auto from, auto to) {
      return counted_length_m(static_cast<int>(from - chain_.begin()),
                              static_cast<int>(to - chain_.begin()));
    };
    // What lies beyond the outermost puncture: no more than the next hold leaves, no less than a
    // jaw has drawn out. Where it is not known yet, a jaw out there holds it taut.
    const auto settle = [&](double& out_m, std::optional<double> most_m,
                            std::optional<double> least_m) {
      const bool known = ends_known_ && std::isfinite(out_m);
      if (!known) out_m = least_m ? *least_m : most_m ? *most_m : out_m;
      if (known && most_m) out_m = std::min(out_m, *most_m);
      if (least_m) out_m = std::max(out_m, *least_m);
    };
    if (free_tail) {
      std::optional<double> most_m, least_m;
      const auto next = std::find_if(first, chain_.end(), is_hold);
      if (next != chain_.end()) most_m = next->arc_m - counted(first, next);
      const auto before = std::find_if(std::make_reverse_iterator(first), chain_.rend(), is_hold);
      if (before != chain_.rend()) least_m = before->arc_m + counted(before.base() - 1, first);
      settle(tail_out_m_, most_m, least_m);
    }
    if (free_head) {
      std::optional<double> most_m, least_m;
      const double whole_m = description_.length_m;
      const auto before =
          std::find_if(std::make_reverse_iterator(last + 1), chain_.rend(), is_hold);
      if (before != chain_.rend())
        most_m = whole_m - before->arc_m - counted(before.base() - 1, last);
      const auto next = std::find_if(last, chain_.end(), is_hold);
      if (next != chain_.end()) least_m = whole_m - next->arc_m + counted(last, next);
      settle(head_out_m_, most_m, least_m);
    }
    ends_known_ = true;
    const bool at_tail = free_tail && tail_out_m_ <= 0.0;
    if (!at_tail && !(free_head && head_out_m_ <= 0.0)) return;
    const Bite& gone = bite(at_tail ? 0 : bite_count() - 1);
    if (gone.open) {  // its needle is still in it
      tail_out_m_ = std::max(tail_out_m_, 0.0);
      return;
    }
    const Vec3 place = (at_tail ? gone.entry : gone.exit).position(tissue.positions_m());
    events.push_back({EventKind::kUnthread, time_s, description_.name,
                      scene_->tissues[at(gone.tissue)].name, place, 0.0});
    drop_bite(at_tail, needles);
    world_changed_ = true;
    build_chain(tissue, needles, tools, time_s);
    // What is left shows at the next puncture.
    (at_tail ? tail_out_m_ : head_out_m_) = std::numeric_limits<double>::infinity();
  }
  ends_known_ = false;
}

void ThreadBody::update(const TissueState& tissue, std::span<NeedleBody> needles,
                        std::span<const ToolBody> tools, double time_s,
                        std::vector<Event>& events) {
  if (needle_ >= 0) take_path(tissue, needles[at(needle_)]);
  for (Hold& hold : holds_)
    hold.bites_before = std::min(hold.bites_before, static_cast<int>(bite_count()));
  build_chain(tissue, needles, tools, time_s);
  feed(tissue, needles, tools, time_s, events);
  draw();
}

void ThreadBody::follow(const TissueState& tissue, std::span<const NeedleBody> needles,
                        std::span<const ToolBody> tools, double time_s) {
  build_chain(tissue, needles, tools, time_s);
  draw();
}

/// Lays out what is seen, and how far along the thread each point of it is.
void ThreadBody::draw() {
  drawn_.clear();
  const int n = static_cast<int>(chain_.size());
  if (description_.ends == scene::ThreadEnds::kHeld) {
    int first = -1, last = -1;
    for (int i = 0; i < n; ++i)
      if (chain_[at(i)].hold) {
        if (first < 0) first = i;
        last = i;
      }
    const auto add = [&](const Vec3& position, double arc, int bites, int point) {
      drawn_.push_back({position, std::clamp(arc, 0.0, description_.length_m), bites, point});
    };
    const auto hang = [&](const Point& from, double length) {
      return Vec3(from.position_m + length * hanging_);
    };
    if (n == 0) return;
    // The tail's end, hanging.
    double arc = first == 0                                      ? chain_[0].arc_m
                 : description_.tail == scene::ThreadTail::kFree ? tail_out_m_
                                                                 : 0.0;
    if (!std::isfinite(arc)) arc = 0.0;
    // What lies before the first hold has no more thread than that hold leaves.
    const double before_first = first > 0 ? chain_[at(first)].arc_m : description_.length_m;
    arc = std::min(arc, before_first);
    if (arc > 0.0) add(hang(chain_[0], arc), 0.0, 0, -1);
    std::size_t span = 0;
    for (int i = 0; i < n; ++i) {
      const Point& point = chain_[at(i)];
      if (point.hold) arc = point.arc_m;
      while (span < spans_.size() && spans_[span].last <= i) ++span;
      const bool spanned = span < spans_.size() && spans_[span].first <= i;
      add(point.position_m, arc, point.bites_before + (point.puncture && !point.inward ? 1 : 0), i);
      if (i + 1 == n) break;
      const Vec3 d = chain_[at(i + 1)].position_m - point.position_m;
      double piece = point.pulls_next ? segment_length(d).length_m : point.fixed_length_m;
      if (spanned && i + 1 == spans_[span].last) {
        // What is slack hangs in the last piece before the hold on the head's side.
        const double whole = chain_[at(i + 1)].arc_m - arc;
        if (whole > piece + 1e-6) {
          const double depth =
              std::min({kSagMax_m, 0.5 * whole, std::sqrt(0.375 * whole * (whole - piece))});
          for (int k = 1; k < kSagPieces; ++k) {
            const double t = static_cast<double>(k) / kSagPieces;
            add(point.position_m + t * d + 4.0 * t * (1.0 - t) * depth * hanging_, arc + t * whole,
                point.bites_before + (point.puncture && !point.inward ? 1 : 0), i);
          }
        }
        piece = whole;
      }
      arc += piece;
      // A span that is stretched has less thread than it is long.
      if (spanned) arc = std::min(arc, chain_[at(spans_[span].last)].arc_m);
      if (i < first) arc = std::min(arc, before_first);
    }
    const double rest = last == n - 1 && chain_[at(n - 1)].kind == Kind::kNeedle
                            ? 0.0
                            : description_.length_m - arc;
    if (rest > 1e-6)
      add(hang(chain_[at(n - 1)], rest), description_.length_m, static_cast<int>(bite_count()),
          n - 1);
    // A thread that hangs on its needle only: all of it is tail.
    if (n == 1 && chain_[0].kind == Kind::kNeedle && drawn_.size() == 1)
      drawn_.insert(drawn_.begin(), {hang(chain_[0], description_.length_m), 0.0, 0, -1});
    return;
  }
  double arc = 0.0;
  for (int i = 0; i < n; ++i) {
    const Point& point = chain_[at(i)];
    drawn_.push_back({point.position_m, arc, point.bites_before, i});
    if (i + 1 < n) arc += (chain_[at(i + 1)].position_m - point.position_m).norm();
  }
}

void ThreadBody::touch(ConstraintRows& rows, constraints::Row& row, const Point& point,
                       const Vec3& gradient, std::span<const NeedleBody> needles,
                       std::span<const ToolBody> tools, double& tissue_part) const {
  switch (point.kind) {
    case Kind::kTissue:
      for (int i = 0; i < point.at.count; ++i)
        rows.touch(point.at.vertices[at(i)], point.at.weight[i] * gradient);
      tissue_part += gradient.dot(point.position_m);
      return;
    case Kind::kTool:
      row.feel(point.body, -tools[at(point.body)].jacobian(point.position_m, gradient));
      return;
    case Kind::kNeedle:
      row.needle = point.body;
      row.needle_jacobian -= needles[at(point.body)].jacobian(point.position_m, gradient);
      return;
  }
}

void ThreadBody::add_rows(std::span<const NeedleBody> needles, std::span<const ToolBody> tools,
                          ConstraintRows& rows) {
  for (Span& span : spans_) {
    double bound = description_.tension_max_n, compliance = kLengthCompliance_m_per_n;
    span.weakest = -1;
    for (const int end : {span.first, span.last}) {
      const Point& hold = chain_[at(end)];
      if (hold.kind != Kind::kTool) continue;
      const ToolBody& tool = tools[at(hold.body)];
      compliance += 1.0 / tool.description().grip_stiffness_n_per_m;
      if (tool.thread_tension_max_n() > bound) continue;
      bound = tool.thread_tension_max_n();
      span.weakest = end;
    }
    // Across each piece: the rows of T H.
    const double tension_n = std::min(span.tension_n, bound);
    if (tension_n > kTensionFloor_n) {
      for (int i = span.first; i < span.last; ++i) {
        const Point &from = chain_[at(i)], &to = chain_[at(i + 1)];
        if (!from.pulls_next) continue;
        const auto piece = segment_length(to.position_m - from.position_m);
        const double across_m_per_n = 1.0 / (tension_n * piece.curvature_per_m);
        std::array<Vec3, 3> axes{Vec3::UnitX(), Vec3::UnitY(), Vec3::UnitZ()};
        std::size_t count = 3;
        if (!piece.is_short) {
          axes[0] = piece.gradient.unitOrthogonal();
          axes[1] = piece.gradient.cross(axes[0]);
          count = 2;
        }
        for (std::size_t k = 0; k < count; ++k) {
          constraints::Row& row = rows.add(Bounds::bilateral(), 0.0, across_m_per_n);
          double tissue_part = 0.0;
          touch(rows, row, to, axes[k], needles, tools, tissue_part);
          touch(rows, row, from, -axes[k], needles, tools, tissue_part);
          row.target_m = tissue_part;  // no force where nothing moves
        }
      }
    }
    double length = 0.0;
    int pieces = 0;
    span.row = rows.size();
    constraints::Row& row = rows.add(Bounds::unilateral(bound), 0.0, compliance);
    row.key = span.key;
    // gap = ℓ − Σ (ℓ_j + g_j · Δ)
    double tissue_part = 0.0;
    Vec3 gradient_before = Vec3::Zero();
    for (int i = span.first; i <= span.last; ++i) {
      Vec3 gradient_after = Vec3::Zero();
      if (i < span.last) {
        if (chain_[at(i)].pulls_next) {
          const auto piece =
              segment_length(chain_[at(i + 1)].position_m - chain_[at(i)].position_m);
          length += piece.length_m;
          gradient_after = piece.gradient;
          ++pieces;
        } else {
          length += chain_[at(i)].fixed_length_m;
        }
      }
      const Vec3 gradient = gradient_after - gradient_before;  // of the gap
      if (!gradient.isZero())
        touch(rows, row, chain_[at(i)], gradient, needles, tools, tissue_part);
      gradient_before = gradient_after;
    }
    span.compliance_m_per_n = compliance;
    const double carried_m = compliance * span.tension_n;  // what the jaws' grips have given way
    const double gap = std::max(span.length_m - length, -(carried_m + kShorteningMax_m * pieces));
    row.target_m = tissue_part - gap;
  }
}

void ThreadBody::commit(const ConstraintRows& rows, std::span<const double> lambda,
                        std::span<const double> gap_m,
                        std::span<const constraints::RowState> states, double time_s,
                        std::vector<Event>& events) {
  for (Span& span : spans_) {
    const std::size_t row = at(span.row);
    span.tension_n = lambda[row];
    span.overlength_m = 0.0;
    const Vec3 place = chain_[at(span.last)].position_m;
    if (states[row] == constraints::RowState::kUpper && gap_m[row] < 0.0) {
      span.overlength_m = -gap_m[row];
      const int slipping = span.weakest;
      if (!span.clamped && slipping < 0)
        events.push_back({EventKind::kLimit, time_s, description_.name, "", place, span.tension_n});
      if (slipping >= 0) {
        const int tool = chain_[at(slipping)].body;
        if (tells_of_slip(tool))
          events.push_back({EventKind::kGripSlip, time_s, scene_->tools[at(tool)].name,
                            description_.name, place, span.tension_n});
        slip(tool, slipping == span.last ? span.overlength_m : -span.overlength_m);
      }
      span.clamped = true;
    } else if (span.tension_n < 0.9 * rows[span.row].bounds.upper_n) {
      span.clamped = false;
    }
    if (span.tension_n > kTaut_n && !span.taut) {
      span.taut = true;
      world_changed_ = true;
      events.push_back({EventKind::kTaut, time_s, description_.name, "", place, span.tension_n});
    } else if (span.tension_n == 0.0 && span.taut) {
      span.taut = false;
      world_changed_ = true;
      events.push_back({EventKind::kSlack, time_s, description_.name, "", place, 0.0});
    }
  }
}

/// Whether this is the first slip in this grip.
bool ThreadBody::tells_of_slip(int tool) {
  for (Hold& hold : holds_)
    if (hold.tool == tool) return !std::exchange(hold.slip_told, true);
  return false;
}

/// Lets thread through a jaw that cannot hold its tension, up to the next one or off its end.
void ThreadBody::slip(int tool, double distance_m) {
  const auto hold =
      std::find_if(holds_.begin(), holds_.end(), [&](const Hold& h) { return h.tool == tool; });
  if (hold == holds_.end()) return;
  const double arc_m = hold->arc_m + distance_m;
  const bool first = hold == holds_.begin(), last = hold + 1 == holds_.end();
  const bool knotted = chain_.front().hold && chain_.front().kind == Kind::kTissue;
  const bool swaged = chain_.back().kind == Kind::kNeedle;
  if ((arc_m < 0.0 && first && !knotted) || (arc_m > description_.length_m && last && !swaged)) {
    holds_.erase(hold);
    world_changed_ = true;
    return;
  }
  hold->arc_m = std::clamp(arc_m, first ? 0.0 : (hold - 1)->arc_m,
                           last ? description_.length_m : (hold + 1)->arc_m);
}

bool ThreadBody::held_by(int tool) const {
  return std::any_of(holds_.begin(), holds_.end(),
                     [&](const Hold& hold) { return hold.tool == tool; });
}

/// The span that the piece from a point of the chain to the next belongs to, or null.
const ThreadBody::Span* ThreadBody::span_from(int point) const {
  for (const Span& span : spans_)
    if (span.first <= point && point < span.last) return &span;
  return nullptr;
}

double ThreadBody::tension_n() const {
  double largest = 0.0;
  for (const Span& span : spans_) largest = std::max(largest, span.tension_n);
  return largest;
}

std::optional<ThreadGrasp> ThreadBody::nearest(const Vec3& point_m, double radius_m) const {
  std::optional<ThreadGrasp> best;
  if (description_.ends == scene::ThreadEnds::kNone) return best;
  for (std::size_t i = 0; i + 1 < drawn_.size(); ++i) {
    const Drawn &a = drawn_[i], &b = drawn_[i + 1];
    if (a.point >= 0 && chain_[at(a.point)].inside_next) continue;  // no jaw reaches in there
    const Vec3 d = b.position_m - a.position_m;
    const double share =
        d.isZero() ? 0.0 : std::clamp(d.dot(point_m - a.position_m) / d.squaredNorm(), 0.0, 1.0);
    const Vec3 p = a.position_m + share * d;
    const double distance = (p - point_m).norm();
    if (distance > radius_m || (best && distance >= best->distance_m)) continue;
    best = ThreadGrasp{distance, p, std::lerp(a.arc_m, b.arc_m, share), a.bites_before, a.point};
  }
  return best;
}

void ThreadBody::grip(int tool, const ThreadGrasp& grasp) {
  Hold hold;
  hold.tool = tool;
  hold.arc_m = grasp.arc_m;
  hold.bites_before = grasp.bites_before;
  // A grip starts without force of its own: on either side the thread is as long as it takes to
  // carry on with the tension there was.
  const Span* const span = span_from(grasp.point);
  const double tension_n = span != nullptr ? span->tension_n : 0.0;
  const auto stretch_m = [&](int holder) {
    return tension_n / scene_->tools[at(holder)].grip_stiffness_n_per_m;
  };
  const auto spare_m = [&](const Point& end, double counted_m, double held_m) {
    const double stretched_m = tension_n * kLengthCompliance_m_per_n + stretch_m(tool) +
                               (end.kind == Kind::kTool ? stretch_m(end.body) : 0.0);
    const double missing_m = counted_m - stretched_m - held_m;
    return tension_n > 0.0 ? missing_m : std::max(0.0, missing_m);
  };
  const int n = static_cast<int>(chain_.size()), next = grasp.point + 1;
  for (int i = grasp.point; i >= 0; --i) {
    const Point& end = chain_[at(i)];
    if (!end.hold) continue;
    const Vec3 piece = grasp.point_m - chain_[at(grasp.point)].position_m;
    hold.spare_before_m =
        spare_m(end, counted_length_m(i, grasp.point) + segment_length(piece).length_m,
                hold.arc_m - end.arc_m + end.spare_after_m);
    break;
  }
  for (int i = next; i < n; ++i) {
    const Point& end = chain_[at(i)];
    if (!end.hold) continue;
    const Vec3 piece = chain_[at(next)].position_m - grasp.point_m;
    hold.spare_after_m = spare_m(end, segment_length(piece).length_m + counted_length_m(next, i),
                                 end.arc_m - hold.arc_m + end.spare_before_m);
    break;
  }
  holds_.insert(std::upper_bound(holds_.begin(), holds_.end(), hold,
                                 [](const Hold& a, const Hold& b) { return a.arc_m < b.arc_m; }),
                hold);
  world_changed_ = true;
}

void ThreadBody::release(int tool) {
  std::erase_if(holds_, [&](const Hold& hold) { return hold.tool == tool; });
  world_changed_ = true;
}

void ThreadBody::report(const TissueState& tissue, ThreadState& state) const {
  state.length_m = description_.ends == scene::ThreadEnds::kHeld
                       ? description_.length_m
                       : (spans_.empty() ? 0.0 : spans_[0].length_m);
  state.tension_n = tension_n();
  state.slack_m = state.overlength_m = 0.0;
  state.taut = false;
  for (const Span& span : spans_) {
    const double spare = span.length_m + span.compliance_m_per_n * span.tension_n -
                         counted_length_m(span.first, span.last);
    if (span.tension_n == 0.0) state.slack_m += std::max(spare, 0.0);
    state.overlength_m = std::max(state.overlength_m, -spare);
    state.taut = state.taut || span.tension_n > 0.0;
  }
  state.head = state.tail = ThreadEnd::kFree;
  state.head_holder = state.tail_holder = -1;
  if (!chain_.empty() && description_.ends == scene::ThreadEnds::kHeld) {
    const auto end = [](const Point& point, ThreadEnd& kind, int& holder) {
      if (!point.hold) return;
      kind = point.kind == Kind::kTool     ? ThreadEnd::kHeld
             : point.kind == Kind::kNeedle ? ThreadEnd::kSwaged
                                           : ThreadEnd::kAnchored;
      holder = point.body;
    };
    end(chain_.back(), state.head, state.head_holder);
    // A thread that its needle alone holds has a free tail.
    if (chain_.size() > 1) end(chain_.front(), state.tail, state.tail_holder);
  }
  state.course_m.clear();
  state.arc_length_m.clear();
  state.segment_tension_n.clear();
  const double whole = drawn_.empty() ? 0.0 : std::max(state.length_m, drawn_.back().arc_m);
  for (std::size_t i = drawn_.size(); i-- > 0;) {
    state.course_m.push_back(drawn_[i].position_m);
    state.arc_length_m.push_back(whole - drawn_[i].arc_m);
    if (i == 0) continue;
    const Span* const span = span_from(drawn_[i - 1].point);
    state.segment_tension_n.push_back(span != nullptr ? span->tension_n : 0.0);
  }
  state.punctures.clear();
  const std::span<const Vec3> rest = tissue.model().vertices_m;
  std::size_t next = drawn_.size();
  for (std::size_t i = chain_.size(); i-- > 0;) {
    const Point& point = chain_[i];
    if (!point.puncture) continue;
    // The drawn course passes every point of the chain, in order.
    while (next > 0 && drawn_[next - 1].position_m != point.position_m) --next;
    ThreadPuncture puncture;
    puncture.tissue = point.body;
    puncture.position_m = point.position_m;
    puncture.rest_position_m = point.at.position(rest);
    puncture.arc_length_m = next > 0 ? whole - drawn_[next - 1].arc_m : 0.0;
    puncture.inward = !point.inward;  // from head to tail it is the other way round
    state.punctures.push_back(puncture);
  }
}

}  // namespace sutured::simulation
