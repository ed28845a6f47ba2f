// SPDX-License-Identifier: GPL-3.0-or-later
// That exactly one of several servers gets a session, whenever they ask.
#include "endpoints/session_claim.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "protocol/endpoint.hpp"
#include "protocol/rendezvous.hpp"
#include "support/test_session.hpp"

namespace sutured::endpoints {
namespace {

using testing::eventually;
using testing::own_session;

constexpr std::chrono::milliseconds kAsk(600);

/// A server that asks.
class Asking {
 public:
  explicit Asking(std::chrono::nanoseconds patience = kAsk) {
    try {
      claim_.emplace(participant_, "scene", patience);
    } catch (const suture::Error& error) {
      EXPECT_EQ(error.code(), suture::ErrorCode::kServerRunning);
      refused_ = error.cause();
    }
  }
  [[nodiscard]] bool holds() const { return claim_.has_value(); }
  [[nodiscard]] const std::string& refused() const { return refused_; }
  [[nodiscard]] SessionClaim& claim() { return *claim_; }

  /// Writes a status as one that serves does.
  void serve() {
    suture::v1::ServerStatus status{};
    identify(status, claim_->server(), "", "scene");
    status.epoch = 7;
    status.state = suture_v1_SERVER_RUNNING;
    claim_->status().write(status);
  }

 private:
  suture::Participant participant_{own_session(), suture::Channel::kControl};
  std::optional<SessionClaim> claim_;
  std::string refused_;
};

TEST(SessionClaim, GoesToOneOfSeveralThatAskAtOnce) {
  std::vector<std::unique_ptr<Asking>> all(3);
  std::vector<std::thread> threads;
  for (auto& one : all) threads.emplace_back([&one] { one = std::make_unique<Asking>(); });
  for (std::thread& thread : threads) thread.join();
  int held = 0;
  for (const auto& one : all) {
    held += one->holds();
    EXPECT_EQ(one->refused().find("has a server: scene \"scene\"") != std::string::npos,
              !one->holds())
        << one->refused();
  }
  EXPECT_EQ(held, 1);
}

TEST(SessionClaim, IsNotGivenTwiceWhileTheHolderStillBuildsItsSimulation) {
  Asking first(std::chrono::milliseconds(1));
  ASSERT_TRUE(first.holds());
  const Asking second;  // whichever has the smaller GUID
  EXPECT_FALSE(second.holds());
  EXPECT_EQ(first.claim().rival(), "");
}

TEST(SessionClaim, IsAskedForWithoutAnyClientTakingThatForAServer) {
  Asking asking;
  const suture::Participant client(own_session(), suture::Channel::kControl);
  EXPECT_FALSE(suture::find_other_server(client, std::chrono::milliseconds(200)));
  asking.serve();
  EXPECT_TRUE(suture::find_other_server(client, std::chrono::seconds(20)));
}

/// Two that did not hear each other at the start, as on a network that was parted.
TEST(SessionClaim, OfTwoThatServeTheOneWithTheGreaterGuidSeesThatItShallGo) {
  Asking asking(std::chrono::nanoseconds(0));
  ASSERT_TRUE(asking.holds()) << asking.refused();
  const suture::Participant elsewhere(own_session(), suture::Channel::kControl);
  suture::Writer<suture::v1::ServerStatus> status(elsewhere);
  const auto serve_as = [&](std::uint8_t byte) {
    suture::Guid guid;
    guid.fill(byte);
    suture::v1::ServerStatus told{};
    identify(told, guid, "", "scene");
    told.epoch = 7;
    told.state = suture_v1_SERVER_RUNNING;
    status.write(told);
  };
  std::string told;
  EXPECT_TRUE(eventually([&] {
    serve_as(0x00);
    told = asking.claim().rival();
    return !told.empty();
  }));
  EXPECT_NE(told.find("has a server"), std::string::npos) << told;
  EXPECT_NE(told.find("--session"), std::string::npos) << told;
  // Matched now: within a process what is written has arrived.
  serve_as(0xff);
  EXPECT_EQ(asking.claim().rival(), "");
}

}  // namespace
}  // namespace sutured::endpoints
