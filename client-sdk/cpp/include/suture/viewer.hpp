// SPDX-License-Identifier: Apache-2.0
// Eyes on a session: meshes, needles, threads, contacts, tools, events and status.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "suture/network.hpp"
#include "suture/types.hpp"

namespace suture {

/// Says which session to watch.
struct SessionOptions {
  std::uint32_t domain = 0;                 ///< even, ≤ 230
  std::string session;                      ///< empty: the default session
  std::chrono::milliseconds timeout{3000};  ///< to find the server
  /// Folder of keys for DDS Security; empty: what `SUTURE_SECURITY` names, or unsecured.
  std::string security{};
  NetworkOptions network{};
};

/// What to do with what arrives. Only what is set is subscribed to.
struct ViewerCallbacks {
  std::function<void(const MeshTopology&)> on_topology;
  std::function<void(const MeshFrame&)> on_frame;
  std::function<void(const ToolView&)> on_tool;
  std::function<void(const NeedleView&)> on_needle;
  std::function<void(const ThreadView&)> on_thread;
  std::function<void(const ContactsView&)> on_contacts;
  std::function<void(const QualityView&)> on_quality;  ///< when a figure changes
  std::function<void(const Event&)> on_event;          ///< the last 1000 first
  std::function<void(const Status&)> on_status;
};

/// Watches a session from one thread of its own, on which all callbacks run. A slow
/// callback loses frames and nothing else. An exception from a callback ends the viewer
/// and comes out of `close`.
class __attribute__((visibility("default"))) Viewer {
 public:
  /// Connects. Throws Error kNoServer, kVersionMismatch, kPermissionDenied, kNetwork or
  /// kBadInput.
  Viewer(const SessionOptions& options, ViewerCallbacks callbacks);
  ~Viewer();
  Viewer(const Viewer&) = delete;
  Viewer& operator=(const Viewer&) = delete;

  /// Ends the callbacks and rethrows what one of them threw. Not from a callback.
  void close();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace suture
