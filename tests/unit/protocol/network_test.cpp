// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/network.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "support/fault_of.hpp"
#include "suture/error.hpp"

namespace suture {
namespace {

using sutured::testing::fault_of;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

/// The first interface that is not loopback; empty where there is none.
std::string outside() {
  try {
    static_cast<void>(find_network({"no such interface", {}, false}, true));
  } catch (const Error& error) {
    const std::string& text = error.mend();
    for (std::size_t at = text.find('('); at != std::string::npos; at = text.find('(', at + 1)) {
      const std::string address = text.substr(at + 1, text.find(')', at) - at - 1);
      if (!address.starts_with("127.")) return address;
    }
  }
  return "";
}

TEST(Network, IsThisMachineWhereNobodySaysOtherwise) {
  const Network network = find_network({}, false);
  EXPECT_EQ(network.address, "127.0.0.1");
  EXPECT_THAT(network.peers, ElementsAre("127.0.0.1"));
  EXPECT_FALSE(network.only_peers);
  EXPECT_THAT(network_configuration(network), HasSubstr("<AllowMulticast>false"));
}

TEST(Network, WithoutKeysWantsToBeToldAloud) {
  const std::string address = outside();
  if (address.empty()) GTEST_SKIP() << "no interface but loopback";
  EXPECT_THAT(fault_of([&] {
                static_cast<void>(find_network({address, {}, false}, false));
              }),
              HasSubstr("--unsecured-network"));
  EXPECT_EQ(find_network({address, {}, true}, false).address, address);
  EXPECT_EQ(find_network({address, {}, false}, true).address, address);
}

TEST(Network, NamesWhatItDoesNotKnow) {
  EXPECT_THAT(fault_of([] {
                static_cast<void>(find_network({"eth99", {}, false}, true));
              }),
              HasSubstr("no interface \"eth99\""));
  EXPECT_THAT(fault_of([] {
                static_cast<void>(find_network({"", {"no.such.host.invalid"}, false}, true));
              }),
              HasSubstr("no.such.host.invalid"));
}

TEST(Network, ListedPeersAreTheOnlyOnes) {
  const Network network = find_network({"", {"127.0.0.2", "127.0.0.2"}, false}, false);
  EXPECT_TRUE(network.only_peers);
  EXPECT_THAT(network.peers, ElementsAre("127.0.0.1", "127.0.0.2"));
}

TEST(Network, LeavesInterfacesToNobodyElse) {
  setenv("CYCLONEDDS_URI",
         "<CycloneDDS><Domain><General><AllowMulticast>true</AllowMulticast></General></Domain>"
         "</CycloneDDS>",
         1);
  EXPECT_THAT(fault_of([] { static_cast<void>(find_network({}, true)); }),
              HasSubstr("CYCLONEDDS_URI"));
  unsetenv("CYCLONEDDS_URI");
}

}  // namespace
}  // namespace suture
