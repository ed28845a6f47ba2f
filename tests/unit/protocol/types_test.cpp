// SPDX-License-Identifier: GPL-3.0-or-later
#include "protocol/types.hpp"

#include <gtest/gtest.h>

#include <set>
#include <string>
#include <type_traits>

#include "protocol/topics.hpp"

namespace suture {
namespace {

static_assert(std::is_trivially_copyable_v<v1::ToolPose>);
static_assert(std::is_trivially_copyable_v<v1::ToolForce>);

TEST(Text, KeepsWhatFitsAndSaysSo) {
  char wire[9];
  EXPECT_TRUE(set_text(wire, "12345678"));
  EXPECT_EQ(text_of(wire), "12345678");
  EXPECT_FALSE(set_text(wire, "123456789"));
  EXPECT_EQ(text_of(wire), "12345678");
  EXPECT_TRUE(set_text(wire, ""));
  EXPECT_EQ(text_of(wire), "");
}

TEST(Text, IsCutBetweenCharacters) {
  char wire[5];
  EXPECT_FALSE(set_text(wire, "abc\xC3\xBC"));  // the last character needs two bytes
  EXPECT_EQ(text_of(wire), "abc");
}

TEST(Text, IsReadSafelyWithoutTerminator) {
  const char wire[4] = {'a', 'b', 'c', 'd'};
  EXPECT_EQ(text_of(wire), "abcd");
}

// Published test vectors of FNV-1a: other languages compute the same key.
TEST(ToolId, IsFnv1a) {
  EXPECT_EQ(tool_id(""), 0xcbf29ce484222325U);
  EXPECT_EQ(tool_id("a"), 0xaf63dc4c8601ec8cU);
  EXPECT_EQ(tool_id("foobar"), 0x85944171f73967e8U);
}

TEST(Topics, HaveNamesOfTheirOwn) {
  std::set<std::string> names;
  for (const TopicSpec& spec : all_topics()) EXPECT_TRUE(names.insert(spec.name).second);
}

TEST(Topics, BelongToTheTypesTheyCarry) {
  EXPECT_STREQ(topic<v1::ToolPose>().descriptor->m_typename, "suture::v1::ToolPose");
  EXPECT_STREQ(topic<v1::ToolForce>().descriptor->m_typename, "suture::v1::ToolForce");
  EXPECT_STREQ(topic<v1::HapticModel>().descriptor->m_typename, "suture::v1::HapticModel");
  EXPECT_STREQ(topic<v1::ToolRendered>().descriptor->m_typename, "suture::v1::ToolRendered");
  EXPECT_STREQ(topic<v1::DeviceProfile>().descriptor->m_typename, "suture::v1::DeviceProfile");
  EXPECT_STREQ(topic<v1::Event>().descriptor->m_typename, "suture::v1::Event");
  EXPECT_STREQ(topic<v1::ServerStatus>().descriptor->m_typename, "suture::v1::ServerStatus");
  EXPECT_STREQ(topic<v1::Command>().descriptor->m_typename, "suture::v1::Command");
  EXPECT_STREQ(topic<v1::CommandReply>().descriptor->m_typename, "suture::v1::CommandReply");
  EXPECT_STREQ(topic<v1::MeshTopology>().descriptor->m_typename, "suture::v1::MeshTopology");
  EXPECT_STREQ(topic<v1::MeshFrame>().descriptor->m_typename, "suture::v1::MeshFrame");
  EXPECT_STREQ(topic<v1::ToolView>().descriptor->m_typename, "suture::v1::ToolView");
  EXPECT_STREQ(topic<v1::NeedleState>().descriptor->m_typename, "suture::v1::NeedleState");
  EXPECT_STREQ(topic<v1::ThreadState>().descriptor->m_typename, "suture::v1::ThreadState");
  EXPECT_STREQ(topic<v1::ContactState>().descriptor->m_typename, "suture::v1::ContactState");
  EXPECT_STREQ(topic<v1::Quality>().descriptor->m_typename, "suture::v1::Quality");
}

// A forces' domain that carried meshes would delay forces by milliseconds.
TEST(Topics, KeepMeshesAwayFromForces) {
  for (const TopicSpec& spec : all_topics()) {
    const std::string type = spec.descriptor->m_typename;
    const bool bulky = type.find("Mesh") != std::string::npos ||
                       type.find("NeedleState") != std::string::npos ||
                       type.find("ThreadState") != std::string::npos;
    if (bulky) {
      EXPECT_EQ(spec.channel, Channel::kMesh) << spec.name;
    }
  }
}

}  // namespace
}  // namespace suture
