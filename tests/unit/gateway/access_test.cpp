// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/access.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <functional>
#include <vector>

#include "protocol/types.hpp"
#include "support/temporary_folder.hpp"
#include "suture/error.hpp"

namespace sutured::gateway {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

Request from(const std::string& host, const std::string& origin = {}) {
  Request request;
  request.path = "/";
  request.host = host;
  request.origin = origin;
  return request;
}

std::string refusal_of(const Access::Options& options) {
  try {
    const Access access(options);
  } catch (const suture::Error& error) {
    return error.what();
  }
  return "";
}

TEST(Access, KnowsLoopback) {
  for (const char* loopback : {"127.0.0.1", "127.9.8.7", "::1"}) EXPECT_TRUE(is_loopback(loopback));
  for (const char* other : {"0.0.0.0", "::", "192.0.2.1", "127.0.0.1.example.org", "", "localhost"})
    EXPECT_FALSE(is_loopback(other)) << other;
}

TEST(Access, TheHashIsSha256) {
  EXPECT_EQ(sha256_hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Access, NobodyComesFromElsewhereWithoutATokenFile) {
  EXPECT_THAT(refusal_of({"0.0.0.0", {}, {}}), HasSubstr("would let everybody in"));
  EXPECT_THAT(refusal_of({"0.0.0.0", {}, {}, true}), HasSubstr("would let everybody in"));
  EXPECT_EQ(refusal_of({"127.0.0.1", {}, {}}), "");
}

TEST(Access, NoTokenTravelsInTheClear) {
  EXPECT_THAT(refusal_of({"::", "tokens.toml", {}}), HasSubstr("in the clear"));
  EXPECT_THAT(refusal_of({"::", "tokens.toml", {}, true}), HasSubstr("tokens.toml"));  // none there
}

TEST(Access, OnLoopbackEverybodyMayDoEverything) {
  const Access access({"127.0.0.1", {}, {}});
  const auto grant = access.grant(from("127.0.0.1:8080"));
  ASSERT_TRUE(grant);
  EXPECT_TRUE(grant->rights.command);
  EXPECT_TRUE(grant->rights.may_drive(suture::tool_id("any")));
}

TEST(Access, RefusesPagesOfOtherOriginsAndForeignNames) {
  const Access access({"127.0.0.1", {}, {"https://app.example.org"}});
  const auto status = [&](const Request& request) {
    const auto refusal = access.refuse(request);
    return refusal ? refusal->status : 200U;
  };
  EXPECT_EQ(status(from("127.0.0.1:8080")), 200U);
  EXPECT_EQ(status(from("localhost:8080", "http://localhost:8080")), 200U);
  EXPECT_EQ(status(from("[::1]:8080", "http://[::1]:8080")), 200U);
  EXPECT_EQ(status(from("127.0.0.1:8080", "https://app.example.org")), 200U);
  EXPECT_EQ(status(from("127.0.0.1:8080", "http://127.0.0.1:9090")), 403U) << "another server";
  EXPECT_EQ(status(from("127.0.0.1:8080", "https://evil.example")), 403U);
  EXPECT_EQ(status(from("127.0.0.1:8080", "null")), 403U);
  EXPECT_EQ(status(from("rebound.example:8080")), 403U);
  EXPECT_EQ(status(from("rebound.example:8080", "http://rebound.example:8080")), 403U);
  EXPECT_EQ(status(from("")), 403U);
}

class TokenFile : public ::testing::Test {
 protected:
  void write(const std::string& text) {
    std::ofstream(path_) << text;
    // Written twice within a tick of the file system's clock is still a change.
    std::filesystem::last_write_time(
        path_, std::filesystem::file_time_type::clock::now() + std::chrono::seconds(++writes_));
  }
  [[nodiscard]] static std::string token(const std::string& name, const std::string& secret,
                                         const std::string& rights) {
    return "[[token]]\nname = \"" + name + "\"\nsha256 = \"" + sha256_hex(secret) +
           "\"\nrights = " + rights + "\n";
  }
  [[nodiscard]] static Request with(const std::string& query, const std::string& header = {}) {
    Request request = from("192.0.2.1:8080");
    request.query = query;
    request.authorization = header;
    return request;
  }
  [[nodiscard]] std::string refusal() const { return refusal_of({"192.0.2.1", path_, {}, true}); }

  testing::TemporaryFolder folder_;
  std::filesystem::path path_ = folder_.path("tokens.toml");
  int writes_ = 0;
};

TEST_F(TokenFile, GivesTheRightsOfTheToken) {
  write(token("ward", "s3cret", R"(["drive:left", "command"])") + token("eyes", "look", "[]"));
  const Access access({"192.0.2.1", path_, {}, true});
  const auto ward = access.grant(with("x=1&token=s3cret"));
  ASSERT_TRUE(ward);
  EXPECT_EQ(ward->name, "ward");
  EXPECT_TRUE(ward->rights.command);
  EXPECT_TRUE(ward->rights.may_drive(suture::tool_id("left")));
  EXPECT_FALSE(ward->rights.may_drive(suture::tool_id("right")));
  const auto eyes = access.grant(with("", "Bearer look"));
  ASSERT_TRUE(eyes);
  EXPECT_FALSE(eyes->rights.command);
  EXPECT_FALSE(eyes->rights.may_drive(suture::tool_id("left")));

  for (const char* query : {"", "token=", "token=s3cre", "token=s3cret2", "tokens=s3cret"})
    EXPECT_FALSE(access.grant(with(query))) << query;
  EXPECT_FALSE(access.grant(with("token=" + sha256_hex("s3cret")))) << "the hash is no token";
}

TEST_F(TokenFile, ATokenInALinkIsDecoded) {
  write(token("ward", "a+b/c= d%", "[]"));
  const Access access({"192.0.2.1", path_, {}, true});
  EXPECT_TRUE(access.grant(with("token=a%2Bb%2Fc%3D+d%25")));
  EXPECT_TRUE(access.grant(with("token=a%2bb/c=%20d%25&x")));
  EXPECT_TRUE(access.grant(with("", "Bearer a+b/c= d%"))) << "a header's is not encoded";
  for (const char* query : {"token=a+b/c=+d%25", "token=a%2Bb%2Fc%3D+d%", "token=%zz", "token=%2"})
    EXPECT_FALSE(access.grant(with(query))) << query;
}

TEST_F(TokenFile, IsReadAgainWhereItChanges) {
  write(token("ward", "s3cret", "[]"));
  Access access({"192.0.2.1", path_, {}, true});
  auto grant = access.grant(with("token=s3cret"));
  ASSERT_TRUE(grant);
  EXPECT_TRUE(access.renew(*grant));

  write(token("ward", "s3cret", R"(["command"])"));
  EXPECT_EQ(access.reload(), "");
  EXPECT_TRUE(access.renew(*grant));
  EXPECT_TRUE(grant->rights.command) << "rights change without a new connection";

  for (const char* faulty : {"[[token]\n", "token = 3\n"}) {
    write(faulty);
    EXPECT_THAT(access.reload(),
                AllOf(HasSubstr("tokens.toml:1:"), HasSubstr("tokens read before still hold")));
    EXPECT_EQ(access.reload(), "") << "told once";
    EXPECT_TRUE(access.renew(*grant)) << "a faulty file changes nothing";
  }

  write(token("other", "0ther", "[]"));
  EXPECT_EQ(access.reload(), "");
  EXPECT_FALSE(access.renew(*grant)) << "revoked";
}

TEST_F(TokenFile, WithoutATokenAnyMoreRevokesAll) {
  const std::string ward = token("ward", "s3cret", "[]");
  const std::vector<std::function<void()>> ways{
      [&] { write(""); },
      [&] { write("# nobody\n"); },
      [&] { write("token = []\n"); },
      [&] { std::filesystem::remove(path_); },
  };
  write(ward);
  Access access({"192.0.2.1", path_, {}, true});
  for (std::size_t way = 0; way < ways.size(); ++way) {
    SCOPED_TRACE(way);
    auto grant = access.grant(with("token=s3cret"));
    ASSERT_TRUE(grant);
    ways[way]();
    EXPECT_EQ(access.reload(), "");
    EXPECT_TRUE(access.renew(*grant)) << "an editor that saves may do that";
    write(ward);
    EXPECT_EQ(access.reload(), "");
    ways[way]();
    EXPECT_EQ(access.reload(), "") << "not two looks in a row";
    EXPECT_TRUE(access.renew(*grant));
    EXPECT_THAT(access.reload(),
                AllOf(HasSubstr(path_.string()), HasSubstr("all tokens are revoked")));
    EXPECT_FALSE(access.renew(*grant));
    EXPECT_FALSE(access.grant(with("token=s3cret")));
    EXPECT_EQ(access.reload(), "") << "told once";
    write("[[token]\n");
    EXPECT_THAT(access.reload(), HasSubstr("none that hold"));
    EXPECT_FALSE(access.grant(with("token=s3cret"))) << "a faulty file gives nothing back";
    write(ward);
    EXPECT_EQ(access.reload(), "");
  }
  EXPECT_TRUE(access.grant(with("token=s3cret")));
}

TEST_F(TokenFile, ComesBackWithTheDateThatItHad) {
  write(token("ward", "s3cret", "[]"));
  Access access({"192.0.2.1", path_, {}, true});
  std::filesystem::rename(path_, folder_.path("aside"));
  EXPECT_EQ(access.reload(), "");
  EXPECT_THAT(access.reload(), HasSubstr("is gone"));
  std::filesystem::rename(folder_.path("aside"), path_);
  EXPECT_EQ(access.reload(), "");
  EXPECT_TRUE(access.grant(with("token=s3cret")));
}

TEST_F(TokenFile, ThatCannotBeLookedAtKeepsTheTokensAndIsTold) {
  write(token("ward", "s3cret", "[]"));
  Access access({"192.0.2.1", path_, {}, true});
  std::filesystem::remove(path_);
  std::filesystem::create_symlink(path_, path_);  // stat fails: too many links
  EXPECT_THAT(access.reload(), HasSubstr("tokens read before still hold"));
  EXPECT_EQ(access.reload(), "") << "told once";
  EXPECT_TRUE(access.grant(with("token=s3cret")));
}

TEST_F(TokenFile, NamesTheFaultAndItsPlace) {
  EXPECT_THAT(refusal(), HasSubstr("tokens.toml: cannot be opened"));  // there is none
  write("");
  EXPECT_THAT(refusal(), HasSubstr("there is no [[token]]"));
  write("token = []");
  EXPECT_THAT(refusal(), HasSubstr("there is no [[token]]"));
  write("[[token]]\nname = \"a\"\nsha256 = \"abc\"\nrights = []\n");
  EXPECT_THAT(refusal(), HasSubstr("64 hex digits"));
  write(token("a", "b", R"(["drive:"])"));
  EXPECT_THAT(refusal(), HasSubstr(":4:"));
  EXPECT_THAT(refusal(), HasSubstr("a right is"));
  write(token("a", "b", "[]") + "colour = 3\n");
  EXPECT_THAT(refusal(), HasSubstr("unknown key \"colour\""));
  write(token("a", "b", "3"));
  EXPECT_THAT(refusal(), HasSubstr("must be a list"));
}

}  // namespace
}  // namespace sutured::gateway
