// SPDX-License-Identifier: GPL-3.0-or-later
#include "soak/hands.hpp"

#include <algorithm>
#include <cmath>

namespace sutured::soak {
namespace {

using simulation::Event;
using simulation::EventKind;
using simulation::Simulation;
using simulation::ToolInput;

// 64 substeps of 0.25 mm: what a step follows without leaping.
constexpr double kStepMotionMax_m = 0.016;
constexpr double kStepTurnMax_rad = 1.5;
constexpr std::size_t kProbe = 2;

std::size_t at(std::int64_t i) { return static_cast<std::size_t>(i); }

}  // namespace

Surgeon::Surgeon(std::uint64_t seed, Temper temper, const scene::Scene& scene)
    : random_(seed ^ 0x5075727365ULL),
      temper_(temper),
      scene_(&scene),
      curve_(needle::Curve::of(scene.needles[0])),
      inputs_(hands_.size()) {
  const Vec3 tail = curve_.point(scene.needles[0].pose, 0.3 * curve_.length_m());
  for (Hand& hand : hands_) {
    hand.input.present = true;
    hand.input.position_m = tail + random_.in(2e-3, 1.5e-2) * random_.direction();
    hand.input.orientation =
        Eigen::Quaterniond(Eigen::AngleAxisd(random_.in(-3.0, 3.0), random_.direction()));
  }
  // The first hand starts where it may take the needle at once.
  if (random_.chance(0.8)) {
    hands_[0].input.position_m = tail + 1e-3 * random_.direction();
    hands_[0].moves.push_back({Kind::kHold, 0.0, 0.0, {}, 1});
    hands_[0].moves.push_back({Kind::kHold, 1.0, 0.0, {}, 2});
  }
}

double Surgeon::speed() {
  return temper_ == Temper::kSensible ? random_.in(0.005, 0.08)
                                      : random_.one_of({0.02, 0.1, 0.3, 1.0});
}

Vec3 Surgeon::on_needle(const Simulation& sim, double share) const {
  const auto& state = sim.needles()[0];
  return curve_.point({state.position_m, state.orientation}, share * curve_.length_m());
}

void Surgeon::reach(Hand& hand, const Vec3& target_m) {
  const Vec3 place = target_m + random_.in(0.0, 1e-3) * random_.direction();
  hand.moves.push_back({Kind::kGo, 0.0, 2.0 * speed(), place, 200});
  hand.moves.push_back({Kind::kHold, 1.0, 0.0, {}, 2});
}

void Surgeon::plan_wild(Hand& hand) {
  const double jaw = hand.held == Held::kNothing ? random_.one_of({0.0, 1.0}) : 1.0;
  switch (random_.below(6)) {
    case 0:
      hand.moves.push_back({Kind::kJump, jaw, 0.0, {}, static_cast<double>(1 + random_.below(4))});
      break;
    case 1:
      hand.moves.push_back({Kind::kTurn, jaw, random_.in(-60.0, 60.0), random_.direction(),
                            static_cast<double>(5 + random_.below(20))});
      break;
    case 2:
      hand.moves.push_back(
          {Kind::kFlutter, jaw, 0.0, {}, static_cast<double>(4 + random_.below(30))});
      break;
    case 3:
      hand.moves.push_back(
          {Kind::kVanish, jaw, 0.0, {}, static_cast<double>(1 + random_.below(15))});
      break;
    case 4:  // tears away, whatever it holds
      hand.moves.push_back({Kind::kGo, jaw, 1.0,
                            hand.input.position_m + random_.in(5e-3, 8e-2) * random_.direction(),
                            100});
      hand.moves.push_back({Kind::kHold, jaw, 0.0, {}, static_cast<double>(random_.below(10))});
      break;
    default:  // rams into whatever is there
      hand.moves.push_back({Kind::kGo, jaw, 1.0, 4e-3 * random_.direction(), 60});
      break;
  }
}

void Surgeon::plan(std::size_t index, const Simulation& sim) {
  Hand& hand = hands_[index];
  if (temper_ == Temper::kWild && random_.chance(0.5)) return plan_wild(hand);
  const auto some_surface = [&] {
    const auto& body = sim.bodies()[at(random_.below(static_cast<int>(sim.bodies().size())))];
    const auto v =
        body.surface_vertices[at(random_.below(static_cast<int>(body.surface_vertices.size())))];
    return sim.rest_positions_m()[at(body.first_vertex + v)];
  };
  if (index == kProbe) {
    const Vec3 target = some_surface();
    const double radius = scene_->tools[kProbe].probe_radius_m;
    hand.moves.push_back({Kind::kGo, 0.0, speed(),
                          target + random_.in(0.0, 2.0 * radius) * random_.direction(), 150});
    hand.moves.push_back({Kind::kHold, 0.0, 0.0, {}, static_cast<double>(random_.below(10))});
    return;
  }
  const auto pull = [&](double distance_m) {
    hand.moves.push_back(
        {Kind::kGo, 1.0, speed(),
         hand.input.position_m + distance_m * (random_.direction() + 0.3 * Vec3::UnitZ()), 150});
  };
  const auto let_go = [&] { hand.moves.push_back({Kind::kHold, 0.0, 0.0, {}, 2}); };
  switch (hand.held) {
    case Held::kNeedle: {
      Hand& other = hands_[1 - index];
      const double choice = random_.in(0.0, 1.0);
      if (choice < 0.6) {
        hand.moves.push_back({Kind::kAlong, 1.0, speed(), {}, random_.in(2e-3, 1.5e-2)});
      } else if (choice < 0.7) {
        hand.moves.push_back({Kind::kAlong, 1.0, -speed(), {}, random_.in(1e-3, 1e-2)});
      } else if (choice < 0.78) {
        pull(random_.in(2e-4, 2e-3));
      } else if (choice < 0.93) {  // hands it over, tip first where that is free
        if (other.held == Held::kNothing) {
          other.moves.clear();
          reach(other, on_needle(sim, random_.in(0.6, 1.0)));
        }
        hand.moves.push_back({Kind::kHold, 1.0, 0.0, {}, 20});
        let_go();
      } else if (choice < 0.97) {  // draws the needle out and the thread after it
        hand.moves.push_back({Kind::kAlong, 1.0, speed(), {}, curve_.length_m()});
        pull(random_.in(0.01, 0.08));
      } else {
        let_go();
      }
      return;
    }
    case Held::kThread:
      random_.chance(0.75) ? pull(random_.in(2e-3, 6e-2)) : let_go();
      return;
    case Held::kTissue:
      random_.chance(0.6) ? pull(random_.in(2e-4, 4e-3)) : let_go();
      return;
    case Held::kNothing:
      break;
  }
  const double choice = random_.in(0.0, 1.0);
  if (choice < 0.5 || sim.threads().empty()) {
    reach(hand, on_needle(sim, random_.in(0.0, 1.0)));
  } else if (choice < 0.8) {
    const auto& course =
        sim.threads()[at(random_.below(static_cast<int>(sim.threads().size())))].course_m;
    if (course.size() < 2) return let_go();
    const auto piece = at(random_.below(static_cast<int>(course.size()) - 1));
    const Vec3 there = course[piece] + random_.in(0.0, 1.0) * (course[piece + 1] - course[piece]);
    reach(hand, there);
  } else if (choice < 0.95) {
    reach(hand, some_surface());
  } else {
    hand.moves.push_back(
        {Kind::kGo, 0.0, speed(), hand.input.position_m + 5e-3 * random_.direction(), 30});
  }
}

/// Plays the first move for one step; returns whether it is done.
bool Surgeon::play(Hand& hand, const Simulation& sim, double dt_s) {
  Move& move = hand.moves.front();
  ToolInput& input = hand.input;
  input.present = move.kind != Kind::kVanish;
  if (move.kind == Kind::kFlutter) {
    input.jaw = random_.in(0.0, 1.0);
  } else {
    input.jaw = move.jaw;
  }
  const double reach_m = std::min(std::abs(move.speed_m_per_s) * dt_s, kStepMotionMax_m);
  switch (move.kind) {
    case Kind::kGo: {
      const Vec3 way = move.target_m - input.position_m;
      const bool there = way.norm() <= reach_m;
      input.position_m += there ? way : Vec3(reach_m * way.normalized());
      return there || --move.amount <= 0.0;
    }
    case Kind::kAlong: {
      const double slide = std::min(reach_m, move.amount) * (move.speed_m_per_s < 0.0 ? -1.0 : 1.0);
      const auto& state = sim.needles()[0];
      const scene::Pose pose{state.position_m, state.orientation};
      const simulation::Vec6 twist = curve_.slide_twist(pose) * slide;
      const double angle = twist.tail<3>().norm();
      const Eigen::Quaterniond turn(
          Eigen::AngleAxisd(angle, angle > 0.0 ? Vec3(twist.tail<3>() / angle) : Vec3::UnitX()));
      input.position_m =
          pose.position_m + turn * (input.position_m - pose.position_m) + twist.head<3>();
      input.orientation = (turn * input.orientation).normalized();
      move.amount -= std::abs(slide);
      return move.amount <= 0.0 || hand.held != Held::kNeedle;
    }
    case Kind::kTurn: {
      const double angle =
          std::clamp(move.speed_m_per_s * dt_s, -kStepTurnMax_rad, kStepTurnMax_rad);
      input.orientation =
          (Eigen::AngleAxisd(angle, move.target_m) * input.orientation).normalized();
      return --move.amount <= 0.0;
    }
    case Kind::kJump:
      input.position_m += random_.in(0.0, kStepMotionMax_m) * random_.direction();
      input.position_m = input.position_m.cwiseMax(-0.03).cwiseMin(0.04);
      return --move.amount <= 0.0;
    case Kind::kHold:
    case Kind::kFlutter:
    case Kind::kVanish:
      return --move.amount <= 0.0;
  }
  return true;
}

const std::vector<ToolInput>& Surgeon::next(const Simulation& sim, double dt_s) {
  for (std::size_t i = 0; i < hands_.size(); ++i) {
    Hand& hand = hands_[i];
    if (hand.moves.empty()) plan(i, sim);
    if (!hand.moves.empty() && play(hand, sim, dt_s)) hand.moves.pop_front();
    inputs_[i] = hand.input;
  }
  return inputs_;
}

void Surgeon::see(std::span<const Event> events) {
  for (const Event& event : events) {
    if (event.kind != EventKind::kGrasp && event.kind != EventKind::kRelease) continue;
    for (std::size_t i = 0; i < hands_.size(); ++i) {
      if (scene_->tools[i].name != event.subject) continue;
      Hand& hand = hands_[i];
      hand.held = Held::kNothing;
      if (event.kind == EventKind::kRelease) continue;
      hand.held = Held::kTissue;
      if (event.object == scene_->needles[0].name) hand.held = Held::kNeedle;
      for (const scene::Thread& thread : scene_->threads)
        if (event.object == thread.name) hand.held = Held::kThread;
    }
  }
}

void Surgeon::forget() {
  for (Hand& hand : hands_) {
    hand.held = Held::kNothing;
    hand.moves.clear();
    hand.input.jaw = 0.0;
  }
}

}  // namespace sutured::soak
