// SPDX-License-Identifier: GPL-3.0-or-later
#include "suture/session.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "protocol/rendezvous.hpp"
#include "support/client_options.hpp"
#include "support/spring_server.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::own_session;
using sutured::testing::SpringServer;

SessionOptions session_options() {
  return sutured::testing::client_options(own_session(), std::chrono::seconds(10));
}

SpringServer::Options server_options() {
  SpringServer::Options options;
  options.session = own_session();
  return options;
}

TEST(Session, TellsTheServersStatus) {
  SpringServer server(server_options());
  Session session(session_options());
  const Status status = session.status();
  EXPECT_EQ(status.scene, "spring");
  EXPECT_EQ(status.state, "running");
  ASSERT_EQ(status.tools.size(), 1U);
  EXPECT_EQ(status.tools[0].tool, "driver");
}

TEST(Session, GetsAReplyToItsCommands) {
  SpringServer server(server_options());
  Session session(session_options());
  EXPECT_EQ(session.command(CommandKind::kPause), "done");
  EXPECT_EQ(session.command(CommandKind::kReset), "done");
  EXPECT_EQ(session.command(CommandKind::kResume), "done");
}

TEST(Session, PassesOnWhyACommandIsRefused) {
  SpringServer server(server_options());
  Session session(session_options());
  try {
    session.command(CommandKind::kStop);
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kPermissionDenied);
    EXPECT_EQ(error.mend(), "springs do not stop");
  }
}

TEST(FindOtherServer, SeesOneInItsOwnSessionOnly) {
  const Participant here(own_session(), Channel::kControl);
  EXPECT_FALSE(find_other_server(here, std::chrono::milliseconds(50)));
  SpringServer server(server_options());
  const std::optional<ServerInfo> other = find_other_server(here, std::chrono::seconds(10));
  ASSERT_TRUE(other);
  EXPECT_EQ(other->host, "here");
  ParticipantOptions elsewhere = own_session();
  elsewhere.session += "-other";
  const Participant there(elsewhere, Channel::kControl);
  EXPECT_FALSE(find_other_server(there, std::chrono::milliseconds(200)));
}

}  // namespace
}  // namespace suture
