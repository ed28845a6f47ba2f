// SPDX-License-Identifier: Apache-2.0
// A haptic device's end of the line. The smallest driver is examples/smallest_device.cpp.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "suture/network.hpp"
#include "suture/types.hpp"

namespace suture {

/// Says who computes the force at the hand.
enum class Render {
  kServer,  ///< the server answers each hand with a force
  kDevice,  ///< the SDK, from the server's haptic models: no network in the loop
};

/// Says which tool of which session to hold.
struct DeviceOptions {
  std::uint32_t domain = 0;         ///< even, ≤ 230
  std::string session;              ///< empty: the default session
  std::string tool;                 ///< as in the scene
  Render render = Render::kServer;  ///< at the beginning; see Device::set_render
  /// What the device can do: told to the server, which keeps to the smaller of this and the
  /// scene's limits; so does the SDK, last before the hand, whoever renders. A model stiffer than
  /// the device renders stably is softened, in those directions only, by a virtual coupling; the
  /// friction of a needle that damps more is held from step to step.
  DeviceLimits limits;
  std::string model;  ///< name of the device for people, at most 63 bytes
  /// Faster than so, in its own frame, no hand moves: beyond it a hand has jumped.
  double max_speed_m_per_s = 2.0;
  std::chrono::milliseconds timeout{3000};  ///< to find the server
  /// Folder of keys for DDS Security; empty: what `SUTURE_SECURITY` names, or unsecured.
  std::string security;
  NetworkOptions network;

  /// Without a force for so long, the SDK takes the last one to zero, within 30 ms more.
  std::chrono::milliseconds silent_after{15};
  /// Without a force for so long, `run` ends with Error kNoServer; zero: never.
  std::chrono::milliseconds give_up_after{5000};

  /// Called for every force of the server as it arrives, on the receiving thread: short,
  /// no waiting.
  std::function<void(const Force&)> on_force;
};

/// Holds one tool of a running simulation: sends where the hand is, gets what it feels.
///
/// A tool belongs to one device at a time; the destructor says goodbye and gives it back.
/// Whatever fails on the other side, the force that `read` and `run` hand out stays within
/// the limits of the tool, goes to zero within 50 ms of the last good one, and comes back
/// by a ramp.
///
/// Hand::stop is the device's emergency stop. The force ends here, at once and by a ramp, with
/// or without a server; and it is asked of the server with every hand until that has said that
/// the tool is stopped. From then on it is stopped until a resume command.
///
/// Threads: one at a time, but for `stop`. Hot calls (`write`, `read`, `feel`, `read_after`)
/// neither throw nor allocate.
class __attribute__((visibility("default"))) Device {
 public:
  /// Decides what the hand does next, or ends `run` with nothing.
  using Tick =
      std::function<std::optional<Hand>(const Force& force, std::chrono::nanoseconds elapsed)>;

  /// Connects. Throws Error kNoServer, kVersionMismatch, kUnknownTool, kToolInUse,
  /// kPermissionDenied, kNetwork or kBadInput; each says what to do.
  explicit Device(DeviceOptions options);
  ~Device();
  Device(Device&&) noexcept;
  Device& operator=(Device&&) noexcept;

  /// Calls `tick` at `rate_hz` by the absolute monotonic clock and sends what it returns,
  /// until it returns nothing or `stop` is called. `elapsed` is the time since the call
  /// before (zero at the first): a period, or more where the system was late. Missed
  /// periods are skipped, never caught up. The thread becomes SCHED_FIFO 60 for the
  /// duration where that is permitted.
  ///
  /// Throws what `tick` throws, Error kNoServer after `give_up_after`, and Error
  /// kToolInUse where another device takes the tool. All forces end at zero.
  void run(const Tick& tick, double rate_hz = 1000.0);

  /// Ends `run` after its present tick. Threads: any; async-signal-safe.
  void stop() noexcept;

  /// Changes who computes the force, while running: the hand feels no step. With
  /// Render::kDevice the server's forces go on until the first models have come and the SDK's
  /// own force is whole, at least 200 ms; then, or at once with Render::kServer, what is shown
  /// goes over within 60 ms and within the tool's slew limit. `renders` says who it is now.
  /// Not a hot call: it may allocate. Throws Error kPermissionDenied or kNetwork.
  void set_render(Render render);
  /// Returns who computes the force that `read` returns.
  [[nodiscard]] Render renders() const noexcept;

  /// Sends where the hand is now, stamped now, and returns its number, counted from 1.
  std::uint64_t write(const Hand& hand) noexcept;

  /// Returns what the hand shall feel now: the server's last answer, or with
  /// Render::kDevice the force for the hand last written.
  [[nodiscard]] Force read() noexcept;

  /// Returns what `hand` shall feel now, without sending it: with Render::kDevice at any
  /// rate, with Render::kServer the same as `read`.
  [[nodiscard]] Force feel(const Hand& hand) noexcept;

  /// Waits until the force that answers hand `sequence`, or a later one, is there.
  [[nodiscard]] std::optional<Force> read_after(std::uint64_t sequence,
                                                std::chrono::nanoseconds timeout) noexcept;

  /// Says whether another device is given this tool's forces.
  [[nodiscard]] bool tool_in_use() const noexcept;

  /// Returns the largest force that the tool may show (N), as the server told.
  [[nodiscard]] double max_force_n() const noexcept;
  /// Returns the scene's name, as the server told.
  [[nodiscard]] const std::string& scene() const noexcept;
  [[nodiscard]] DeviceStatistics statistics() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace suture
