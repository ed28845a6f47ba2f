// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/participant.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "protocol/endpoint.hpp"
#include "support/test_session.hpp"

namespace suture {
namespace {

using sutured::testing::eventually;
using sutured::testing::own_session;

ErrorCode code_of(const ParticipantOptions& options) {
  try {
    const Participant participant(options, Channel::kControl);
  } catch (const Error& error) {
    EXPECT_FALSE(error.mend().empty());
    return error.code();
  }
  ADD_FAILURE() << "no error";
  return ErrorCode::kNetwork;
}

TEST(Participant, RefusesOddAndTooLargeDomains) {
  ParticipantOptions options = own_session();
  options.domain = 3;
  EXPECT_EQ(code_of(options), ErrorCode::kBadInput);
  options.domain = 232;
  EXPECT_EQ(code_of(options), ErrorCode::kBadInput);
}

TEST(Participant, RefusesSessionNamesThatArePatterns) {
  ParticipantOptions options = own_session();
  options.session = "*";
  EXPECT_EQ(code_of(options), ErrorCode::kBadInput);
}

TEST(Participant, JoinsTheLastDomain) {
  ParticipantOptions options = own_session();
  options.domain = 230;
  const Participant control(options, Channel::kControl);
  const Participant mesh(options, Channel::kMesh);
  EXPECT_GT(mesh.handle(), 0);
}

TEST(Participant, ComesBackAfterItsDomainWasLeft) {
  for (int i = 0; i < 3; ++i) {
    const Participant first(own_session(), Channel::kControl);
    const Participant second(own_session(), Channel::kControl);
    EXPECT_GT(first.handle(), 0);
    EXPECT_GT(second.handle(), 0);
  }
}

TEST(Participant, ReportsAFaultInTheUsersConfiguration) {
  setenv(
      "CYCLONEDDS_URI",
      "<CycloneDDS><Domain><General><NoSuchThing>1</NoSuchThing></General></Domain></CycloneDDS>",
      1);
  EXPECT_EQ(code_of(own_session()), ErrorCode::kNetwork);
  unsetenv("CYCLONEDDS_URI");
}

TEST(Participant, TakesTheUsersConfigurationOnTopOfOurs) {
  setenv("CYCLONEDDS_URI",
         "<CycloneDDS><Domain><Tracing><Verbosity>warning</Verbosity></Tracing>"
         "<SharedMemory><Enable>true</Enable></SharedMemory></Domain></CycloneDDS>",
         1);
  const Participant participant(own_session(), Channel::kControl);  // no shared memory after all
  unsetenv("CYCLONEDDS_URI");
  EXPECT_GT(participant.handle(), 0);
}

TEST(Session, IsNotSeenFromAnother) {
  ParticipantOptions other = own_session();
  other.session += "-other";
  const Participant here(own_session(), Channel::kControl);
  const Participant there(other, Channel::kControl);
  Writer<v1::Command> writer(here);
  const Reader<v1::Command> own(here);
  const Reader<v1::Command> foreign(there);
  ASSERT_TRUE(eventually([&] { return writer.matched() == 1; }));
  EXPECT_EQ(own.matched(), 1);
  EXPECT_EQ(foreign.matched(), 0);
}

TEST(Participant, CarriesOnlyTheTopicsOfItsChannel) {
  const Participant control(own_session(), Channel::kControl);
  EXPECT_THROW(const Reader<v1::MeshFrame> reader(control), Error);
}

}  // namespace
}  // namespace suture
