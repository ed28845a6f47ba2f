// SPDX-License-Identifier: Apache-2.0
#include "recorded_surgeon.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "protocol/topics.hpp"
#include "sample_facts.hpp"

namespace suture::cli {
namespace {

struct Step {
  StepFacts facts;
  std::uint64_t log_time_ns = 0;
};
struct Jaw {
  std::uint64_t log_time_ns = 0;
  double jaw = 0.0;
};

/// One world of the recording.
struct Epoch {
  std::map<std::string, std::vector<Step>> tools;  // steps in their order
  std::string scene;
  double rate_hz = 0.0;
};

struct Taken {
  std::map<std::uint64_t, Epoch> epochs;
  // By tool and number; devices that follow one another count anew.
  std::map<std::pair<std::uint64_t, std::uint64_t>, std::vector<Jaw>> jaws;
  bool models = false;
};

Taken take(mcap::Reader& recording) {
  Taken taken;
  mcap::Message message;
  while (recording.next(message)) {
    const std::string& name = recording.channel(message).topic;
    if (name == topic<v1::HapticModel>().name) {
      taken.models = true;
      if (std::optional<StepFacts> facts = step_facts(message.data)) {
        std::vector<Step>& steps = taken.epochs[facts->epoch].tools[facts->tool];
        if (!steps.empty() && facts->step <= steps.back().facts.step) continue;
        steps.push_back({std::move(*facts), message.log_time_ns});
      }
    } else if (name == topic<v1::ToolPose>().name) {
      if (const std::optional<JawFacts> facts = jaw_facts(message.data)) {
        taken.jaws[{facts->tool_id, facts->sequence}].push_back({message.log_time_ns, facts->jaw});
      }
    } else if (name == topic<v1::ServerStatus>().name) {
      if (const std::optional<ServerFacts> facts = server_facts(message.data)) {
        taken.epochs[facts->epoch].scene = facts->scene;
        taken.epochs[facts->epoch].rate_hz = facts->rate_hz;
      }
    }
  }
  return taken;
}

bool any_engaged(const Epoch& epoch) {
  for (const auto& [tool, steps] : epoch.tools)
    for (const Step& step : steps)
      if (step.facts.engaged) return true;
  return false;
}

/// The jaw of the pose that a step took: of all poses of that number, the one next in time.
std::optional<double> jaw_of(const Taken& taken, const Step& step) {
  const auto found = taken.jaws.find({tool_id(step.facts.tool), step.facts.pose_sequence});
  if (found == taken.jaws.end()) return std::nullopt;
  const auto distance = [&](const Jaw& jaw) {
    return jaw.log_time_ns > step.log_time_ns ? jaw.log_time_ns - step.log_time_ns
                                              : step.log_time_ns - jaw.log_time_ns;
  };
  return std::min_element(found->second.begin(), found->second.end(),
                          [&](const Jaw& a, const Jaw& b) { return distance(a) < distance(b); })
      ->jaw;
}

/// What keeps a run from being the session again.
struct Flaws {
  std::uint64_t stretched = 0, missing = 0, jaws = 0;
  std::vector<std::string> others;
};

SurgeonTrack track_of(const Taken& taken, const std::string& tool, const std::vector<Step>& steps,
                      double rate_hz, Flaws& flaws) {
  SurgeonTrack track{tool, {}};
  double jaw = 0.0;
  std::optional<double> left_s;  // when the hand left, where it did
  std::uint64_t stretched = 0, missing = 0;
  if (steps.front().facts.engaged && steps.front().facts.step > 1) {
    flaws.others.push_back(
        "tool \"" + tool +
        "\": a hand held it before the recording began; that is not in the file");
  }
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const StepFacts& facts = steps[i].facts;
    // Where the server kept its rate, a time is a whole number of steps: say it in the very
    // digits of `sutured run`.
    const double number = std::round(facts.simulation_time_s * rate_hz);
    const double time_s = std::abs(facts.simulation_time_s * rate_hz - number) < 0.01
                              ? number / rate_hz
                              : facts.simulation_time_s;
    if (i > 0) {
      const std::uint64_t skipped = facts.step - steps[i - 1].facts.step - 1;
      missing += skipped;
      const double length =
          (facts.simulation_time_s - steps[i - 1].facts.simulation_time_s) * rate_hz;
      if (skipped == 0 && length > 1.5) ++stretched;
    }
    if (!facts.engaged) {
      if (!track.rows.empty() && !left_s) left_s = time_s;
      continue;
    }
    if (left_s) {
      flaws.others.push_back("tool \"" + tool + "\": its hand left from " +
                             std::to_string(*left_s) + " to " + std::to_string(time_s) +
                             " s; in the file it waits there");
      SurgeonRow waits = track.rows.back();
      waits.time_s = time_s - 1.0 / rate_hz;
      if (waits.time_s > track.rows.back().time_s) track.rows.push_back(waits);
      left_s.reset();
    }
    if (const std::optional<double> known = jaw_of(taken, steps[i])) {
      jaw = std::clamp(*known, 0.0, 1.0);
    } else {
      ++flaws.jaws;
    }
    if (!track.rows.empty() && time_s <= track.rows.back().time_s) continue;
    track.rows.push_back({time_s, {facts.position_m, facts.orientation_xyzw, jaw}});
  }
  flaws.stretched = std::max(flaws.stretched, stretched);
  flaws.missing = std::max(flaws.missing, missing);
  return track;
}

}  // namespace

RecordedSurgeon surgeon_of(mcap::Reader& recording, std::optional<std::uint64_t> epoch) {
  const Taken taken = take(recording);
  if (!taken.models) {
    throw Error(ErrorCode::kBadInput,
                "the recording has no samples of suture/tool/model, which tell where the "
                "simulation took the tools",
                "record without --topics, or with suture/tool/model, suture/tool/pose and "
                "suture/status");
  }
  std::vector<std::uint64_t> moved;
  std::string known;
  for (const auto& [number, world] : taken.epochs) {
    if (!any_engaged(world)) continue;
    moved.push_back(number);
    known += (known.empty() ? "" : ", ") + std::to_string(number);
  }
  if (moved.empty()) {
    throw Error(ErrorCode::kBadInput, "no hand moved a tool in this recording",
                "start `suture record` before the device");
  }
  if (epoch && std::find(moved.begin(), moved.end(), *epoch) == moved.end()) {
    throw Error(ErrorCode::kBadInput, "no hand moved a tool in the epoch " + std::to_string(*epoch),
                "the recording has " + known);
  }
  RecordedSurgeon result;
  result.epoch = epoch.value_or(moved.back());
  const Epoch& world = taken.epochs.at(result.epoch);
  result.scene = world.scene;
  result.rate_hz = world.rate_hz;
  if (!(result.rate_hz > 0.0)) {
    throw Error(ErrorCode::kBadInput, "the recording has no suture/status of this epoch",
                "record without --topics, or with suture/status as well");
  }
  Flaws flaws;
  for (const auto& [tool, steps] : world.tools) {
    SurgeonTrack track = track_of(taken, tool, steps, result.rate_hz, flaws);
    if (!track.rows.empty()) result.surgeon.tracks.push_back(std::move(track));
  }
  if (moved.size() > 1) {
    result.notes.push_back("the recording has several worlds (epochs " + known +
                           "): this is one of them, --epoch takes another");
  }
  if (flaws.stretched > 0) {
    result.notes.push_back(std::to_string(flaws.stretched) +
                           " steps of the server were stretched, because it was late: a run takes "
                           "several in their place");
  }
  if (flaws.missing > 0) {
    result.notes.push_back(std::to_string(flaws.missing) +
                           " steps were not recorded: hands move evenly over them");
  }
  if (flaws.jaws > 0) {
    result.notes.push_back(std::to_string(flaws.jaws) +
                           " poses were not recorded: their jaws are those of the step before");
  }
  result.notes.insert(result.notes.end(), flaws.others.begin(), flaws.others.end());
  return result;
}

}  // namespace suture::cli
