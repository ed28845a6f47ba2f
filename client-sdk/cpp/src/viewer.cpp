// SPDX-License-Identifier: Apache-2.0
#include "suture/viewer.hpp"

#include <atomic>
#include <exception>
#include <optional>
#include <thread>

#include "convert.hpp"
#include "protocol/endpoint.hpp"
#include "protocol/rendezvous.hpp"

namespace suture {
namespace {

/// A reader that exists only where somebody wants its samples.
template <class T>
class Subscription {
 public:
  void open(bool wanted, const Participant& participant, WaitSet& waitset) {
    if (!wanted) return;
    reader_.emplace(participant);
    waitset.attach(*reader_);
  }
  template <class Use>
  void drain(Use&& use) {
    if (!reader_) return;
    reader_->take_each([&](const T& sample, const SampleInfo& info) {
      if (info.valid) use(sample);
    });
  }

 private:
  std::optional<Reader<T>> reader_;
};

}  // namespace

struct Viewer::State {
  State(const SessionOptions& options, ViewerCallbacks chosen)
      : callbacks(std::move(chosen)),
        control({.domain = options.domain,
                 .session = options.session,
                 .security = options.security,
                 .network = options.network},
                Channel::kControl),
        mesh({.domain = options.domain,
              .session = options.session,
              .security = options.security,
              .network = options.network},
             Channel::kMesh) {
    static_cast<void>(await_server(control, options.timeout));
    event.open(static_cast<bool>(callbacks.on_event), control, waitset);
    status.open(static_cast<bool>(callbacks.on_status), control, waitset);
    topology.open(static_cast<bool>(callbacks.on_topology), mesh, waitset);
    frame.open(static_cast<bool>(callbacks.on_frame), mesh, waitset);
    tool.open(static_cast<bool>(callbacks.on_tool), mesh, waitset);
    needle.open(static_cast<bool>(callbacks.on_needle), mesh, waitset);
    thread.open(static_cast<bool>(callbacks.on_thread), mesh, waitset);
    contacts.open(static_cast<bool>(callbacks.on_contacts), mesh, waitset);
    quality.open(static_cast<bool>(callbacks.on_quality), mesh, waitset);
    worker = std::thread([this] { work(); });
  }

  ~State() { stop(); }

  void stop() noexcept {
    if (!worker.joinable()) return;
    leaving = true;
    waitset.wake();
    worker.join();
  }

  void work() noexcept {
    try {
      while (!leaving) {
        waitset.wait(std::chrono::seconds(1));
        // Topologies before the frames that need them.
        status.drain([&](const auto& wire) {
          if (wire.epoch != 0) callbacks.on_status(to_status(wire));
        });
        topology.drain([&](const auto& wire) { callbacks.on_topology(to_topology(wire)); });
        frame.drain([&](const auto& wire) { callbacks.on_frame(to_frame(wire)); });
        needle.drain([&](const auto& wire) { callbacks.on_needle(to_needle(wire)); });
        thread.drain([&](const auto& wire) { callbacks.on_thread(to_thread(wire)); });
        contacts.drain([&](const auto& wire) { callbacks.on_contacts(to_contacts(wire)); });
        quality.drain([&](const auto& wire) { callbacks.on_quality(to_quality(wire)); });
        tool.drain([&](const auto& wire) { callbacks.on_tool(to_tool(wire)); });
        event.drain([&](const auto& wire) { callbacks.on_event(to_event(wire)); });
      }
    } catch (...) {
      thrown = std::current_exception();
    }
  }

  ViewerCallbacks callbacks;
  Participant control;
  Participant mesh;
  Subscription<v1::Event> event;
  Subscription<v1::ServerStatus> status;
  Subscription<v1::MeshTopology> topology;
  Subscription<v1::MeshFrame> frame;
  Subscription<v1::ToolView> tool;
  Subscription<v1::NeedleState> needle;
  Subscription<v1::ThreadState> thread;
  Subscription<v1::ContactState> contacts;
  Subscription<v1::Quality> quality;
  WaitSet waitset;  // after the readers: destroyed before them
  std::atomic<bool> leaving{false};
  std::exception_ptr thrown;  // the worker's, until it is joined
  std::thread worker;
};

Viewer::Viewer(const SessionOptions& options, ViewerCallbacks callbacks)
    : state_(std::make_unique<State>(options, std::move(callbacks))) {}

Viewer::~Viewer() = default;

void Viewer::close() {
  state_->stop();
  if (state_->thrown) std::rethrow_exception(std::exchange(state_->thrown, nullptr));
}

}  // namespace suture
