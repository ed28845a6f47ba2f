// SPDX-License-Identifier: GPL-3.0-or-later
// The web's door to a session.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "protocol/participant.hpp"

namespace sutured::gateway {

/// Serves the page, `/healthz`, `/metrics` and Foxglove's WebSocket protocol for one
/// session, on a thread of its own.
///
/// To the session it is a stranger: it takes part in both domains with participants of its
/// own, as if from another process, so that no browser reaches a thread of the forces
/// (docs/adr/0041). Its threads and theirs run at nice 10 (docs/adr/0044).
/// Threads: the owner's; `log` is called on the gateway's.
class Gateway {
 public:
  struct Options {
    std::string address = "127.0.0.1";
    std::uint16_t port = 8080;         ///< 0: any free one
    std::filesystem::path page;        ///< folder of the web page; need not exist
    std::filesystem::path tokens;      ///< see Access
    std::vector<std::string> origins;  ///< see Access
    std::string certificate, key;      ///< PEM files; empty: no TLS
    /// Told what people should know of; `bad` where it wants a mend.
    std::function<void(bool bad, const std::string&)> log = [](bool, const std::string&) {};
  };

  /// Binds, takes part in the session, and serves; a server of the session may come later.
  /// Throws suture::Error: kBadInput for options that cannot be, kNetwork where it cannot bind.
  Gateway(const suture::ParticipantOptions& session, Options options);
  /// Says goodbye to all clients and ends, within a third of a second.
  ~Gateway();
  Gateway(const Gateway&) = delete;
  Gateway& operator=(const Gateway&) = delete;

  /// Returns where the page is: `http://127.0.0.1:8080/`.
  [[nodiscard]] std::string url() const;
  /// Returns how many more clients watch the scene than there are readers of frames for them:
  /// what is to be added to the readers that DDS counts. Counted twice a second. Threads: any.
  [[nodiscard]] int viewers_beyond_readers() const noexcept;

 private:
  class State;
  std::unique_ptr<State> state_;
};

}  // namespace sutured::gateway
