// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/metrics.hpp"

#include <array>
#include <sstream>
#include <string_view>
#include <utility>

namespace sutured::gateway {
namespace {

// The text format 0.0.4: HELP and TYPE once a metric, then its samples.
class Exposition {
 public:
  Exposition() { text_.precision(10); }

  void metric(std::string_view name, std::string_view type, std::string_view help) {
    name_ = "sutured_" + std::string(name);
    text_ << "# HELP " << name_ << ' ' << help << "\n# TYPE " << name_ << ' ' << type << '\n';
  }
  template <class Value>
  void sample(Value value, const std::string& labels = {}) {
    text_ << name_;
    if (!labels.empty()) text_ << '{' << labels << '}';
    text_ << ' ' << value << '\n';
  }
  template <class Value>
  void single(std::string_view name, std::string_view type, std::string_view help, Value value) {
    metric(name, type, help);
    sample(value);
  }
  [[nodiscard]] std::string text() const { return text_.str(); }

 private:
  std::ostringstream text_;
  std::string name_;
};

std::string label(std::string_view name, std::string_view value) {
  std::string text = std::string(name) + "=\"";
  for (const char c : value) {
    if (c == '\\' || c == '"') text += '\\';
    if (c == '\n') {
      text += "\\n";
    } else {
      text += c;
    }
  }
  return text + '"';
}

void percentiles(Exposition& out, std::string_view name, std::string_view help,
                 const suture::v1::Percentiles& values) {
  constexpr double kMicrosecond = 1e-6;
  out.metric(name, "gauge", help);
  out.sample(values.p50_us * kMicrosecond, "quantile=\"0.5\"");
  out.sample(values.p99_us * kMicrosecond, "quantile=\"0.99\"");
  out.sample(values.max_us * kMicrosecond, "quantile=\"1\"");
}

void server_metrics(Exposition& out, const suture::v1::ServerStatus& status) {
  constexpr std::array<std::string_view, 5> kStates{"starting", "running", "paused", "stopped",
                                                    "leaving"};
  out.metric("state", "gauge", "1 for the state that the server is in.");
  for (std::size_t i = 0; i < kStates.size(); ++i)
    out.sample(static_cast<std::size_t>(status.state) == i ? 1 : 0, label("state", kStates[i]));
  out.single("simulation_time_seconds", "gauge", "Time of the scene since its last reset.",
             status.simulation_time_s);
  out.single("steps_total", "counter", "Simulation steps since start.", status.steps);
  out.single("step_rate_asked_hertz", "gauge", "Simulation rate asked for.", status.rate_hz);
  out.single("step_rate_hertz", "gauge", "Simulation rate achieved.", status.achieved_rate_hz);
  out.single("overruns_total", "counter", "Steps past their period.", status.overruns);
  percentiles(out, "step_seconds", "A simulation step without display, of the last period.",
              status.step);
  out.metric("stage_seconds", "gauge", "Mean time of a stage of the step, of the last period.");
  for (std::uint32_t i = 0; i < status.stages._length; ++i)
    out.sample(status.stages._buffer[i].mean_us * 1e-6,
               label("stage", suture::text_of(status.stages._buffer[i].stage)));
  percentiles(out, "wakeup_seconds", "The supervisor, late against its clock.", status.wakeup);
  percentiles(out, "write_seconds", "Writing a force to DDS.", status.write);
  out.single("missed_ticks_total", "counter", "Ticks that the supervisor missed.",
             status.missed_ticks);
  out.single("frame_rate_hertz", "gauge", "Mesh frames published.", status.frame_rate_hz);
  out.single("bodies", "gauge", "Deformable bodies.", status.bodies);
  out.single("vertices", "gauge", "Vertices of all bodies.", status.vertices);
  out.single("tets", "gauge", "Tetrahedra of all bodies.", status.tets);
  out.single("rows", "gauge", "Constraint rows of the last step.", status.rows);
  out.single("contacts", "gauge", "Pairs in contact.", status.contacts);
  out.single("complementarity_residual", "gauge", "Of the last frame's step.",
             status.complementarity_residual);
  out.single("devices", "gauge", "Tools whose lease is held.", status.devices);
  out.single("viewers", "gauge", "Who watches the scene, over DDS or the web.", status.viewers);

  using Tool = suture::v1::ToolStatus;
  const auto each = [&](std::string_view name, std::string_view type, std::string_view help,
                        auto value) {
    out.metric(name, type, help);
    for (std::uint32_t i = 0; i < status.tools._length; ++i) {
      const Tool& tool = status.tools._buffer[i];
      out.sample(value(tool), label("tool", suture::text_of(tool.tool)));
    }
  };
  each("tool_leased", "gauge", "1 while a device holds the tool.",
       [](const Tool& tool) { return tool.leased ? 1 : 0; });
  each("tool_pose_rate_hertz", "gauge", "Poses taken.",
       [](const Tool& tool) { return tool.pose_rate_hz; });
  each("tool_force_rate_hertz", "gauge", "Forces sent.",
       [](const Tool& tool) { return tool.force_rate_hz; });
  each("tool_poses_total", "counter", "Poses taken.", [](const Tool& tool) { return tool.poses; });
  each("tool_poses_lost_total", "counter", "Gaps in the sequence of poses.",
       [](const Tool& tool) { return tool.poses_lost; });
  each("tool_poses_dropped_total", "counter", "Poses refused or beyond 4 kHz.",
       [](const Tool& tool) { return tool.poses_dropped; });
  each("tool_faults_total", "counter", "Faults since start.",
       [](const Tool& tool) { return tool.fault_count; });
  each("tool_faults_present", "gauge", "Bits of the faults present (FAULT_* of the IDL).",
       [](const Tool& tool) { return tool.faults; });
  each("tool_takeovers_total", "counter", "Times that the supervisor had to answer.",
       [](const Tool& tool) { return tool.takeovers; });
  each("tool_force_newtons", "gauge", "Force shown now.",
       [](const Tool& tool) { return tool.force_n; });
  each("tool_peak_force_newtons", "gauge", "Largest force shown since start.",
       [](const Tool& tool) { return tool.peak_force_n; });
  each("tool_model_age_seconds", "gauge", "Oldest model evaluated in the period.",
       [](const Tool& tool) { return tool.model_age_ms * 1e-3; });
  each("tool_tick_p99_seconds", "gauge", "Pose taken to force written, 99th percentile.",
       [](const Tool& tool) { return tool.tick.p99_us * 1e-6; });
  each("tool_energy_joules", "gauge", "Energy given to the hand since engagement.",
       [](const Tool& tool) { return tool.energy_to_hand_j; });
}

}  // namespace

std::string metrics_text(const suture::v1::ServerStatus* status, const WebCounters& web,
                         const ClientCounters& clients) {
  Exposition out;
  if (status != nullptr) {
    out.metric("info", "gauge", "What runs.");
    out.sample(1, label("version", suture::text_of(status->server_version)) + ',' +
                      label("scene", suture::text_of(status->scene)) + ',' +
                      label("session", suture::text_of(status->session)));
    server_metrics(out, *status);
  }
  out.single("web_clients", "gauge", "WebSockets open.", clients.clients);
  out.single("web_dropped_samples_total", "counter", "Samples that clients were too slow for.",
             clients.dropped);
  out.single("web_waiting_bytes", "gauge", "Bytes that wait for slow clients.",
             clients.waiting_bytes);
  out.single("web_connections", "gauge", "Connections open.", web.connections_open);
  out.single("web_connections_total", "counter", "Connections accepted.", web.connections);
  out.single("web_connections_refused_total", "counter", "Connections beyond the limit.",
             web.connections_refused);
  out.single("web_requests_total", "counter", "HTTP requests.", web.requests);
  out.single("web_faults_total", "counter", "Connections and tasks that an exception ended.",
             web.faults);
  out.single("web_sent_bytes_total", "counter", "Bytes of WebSocket messages sent.",
             web.bytes_sent);
  out.single("web_received_bytes_total", "counter", "Bytes of WebSocket messages received.",
             web.bytes_received);
  return out.text();
}

}  // namespace sutured::gateway
