// SPDX-License-Identifier: GPL-3.0-or-later
// Pins the wire types. A published type never changes: a device in the field would no
// longer match, and say no more than that. Where this fails on purpose, before a release,
// renew the number; after one, make a new module and topic instead.
#include <gtest/gtest.h>

#include <map>
#include <string>

#include "protocol/topics.hpp"

namespace suture {
namespace {

/// A fingerprint of names, types, keys and bounds of all members, as XTypes describes them.
std::uint64_t fingerprint(const dds_topic_descriptor_t& descriptor) {
  const auto* bytes = descriptor.type_information.data;
  return tool_id({reinterpret_cast<const char*>(bytes), descriptor.type_information.sz});
}

TEST(Contract, IsWhatWasPublished) {
  const std::map<std::string, std::uint64_t> published = {
      {"suture::v1::ToolPose", 15163219879815577176U},
      {"suture::v1::ToolForce", 15104401843607927309U},
      {"suture::v1::HapticModel", 18182830569220218481U},
      {"suture::v1::ToolRendered", 2186318450677105471U},
      {"suture::v1::DeviceProfile", 11345085107409444153U},
      {"suture::v1::Event", 14728885425181857786U},
      {"suture::v1::ServerStatus", 13148945350279346076U},
      {"suture::v1::Command", 5932826398824730769U},
      {"suture::v1::CommandReply", 9175052838327788900U},
      {"suture::v1::MeshTopology", 9657672944120058517U},
      {"suture::v1::MeshFrame", 12162321856301997006U},
      {"suture::v1::ToolView", 7437166787114956727U},
      {"suture::v1::NeedleState", 13675588109811935984U},
      {"suture::v1::ThreadState", 8352736841554587535U},
      {"suture::v1::ContactState", 16132567106403172354U},
      {"suture::v1::Quality", 17469171334379713586U},
  };
  EXPECT_EQ(published.size(), all_topics().size());
  for (const TopicSpec& spec : all_topics()) {
    const std::string type = spec.descriptor->m_typename;
    const auto found = published.find(type);
    ASSERT_NE(found, published.end()) << type;
    EXPECT_EQ(fingerprint(*spec.descriptor), found->second)
        << "{\"" << type << "\", " << fingerprint(*spec.descriptor) << "U},";
  }
}

}  // namespace
}  // namespace suture
