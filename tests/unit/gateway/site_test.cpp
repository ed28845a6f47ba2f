// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/site.hpp"

#include <gtest/gtest.h>

#include <filesystem>

#include "support/temporary_folder.hpp"

namespace sutured::gateway {
namespace {

class SiteTest : public ::testing::Test {
 protected:
  SiteTest() {
    std::filesystem::create_directories(folder_.path("page/assets"));
    write("secret.txt", "outside");
    write("page/index.html", "<html>");
    write("page/assets/app-1234.js", "code");
    write("page/assets/app-1234.js.gz", "packed");
  }
  void write(const std::string& name, const std::string& text) const { folder_.write(name, text); }
  [[nodiscard]] static Request ask(const std::string& path, bool gzip = false) {
    Request request;
    request.path = path;
    request.accepts_gzip = gzip;
    return request;
  }

  testing::TemporaryFolder folder_;
};

TEST_F(SiteTest, ServesThePage) {
  const Site site(folder_.path("page"));
  const Reply index = site.get(ask("/"));
  EXPECT_EQ(index.status, 200U);
  EXPECT_EQ(*index.body, "<html>");
  EXPECT_EQ(index.content_type, "text/html; charset=utf-8");
  EXPECT_FALSE(index.immutable);
  const Reply script = site.get(ask("/assets/app-1234.js"));
  EXPECT_EQ(*script.body, "code");
  EXPECT_TRUE(script.immutable);
}

TEST_F(SiteTest, SendsTheCompressedFileToWhoAcceptsIt) {
  const Site site(folder_.path("page"));
  const Reply packed = site.get(ask("/assets/app-1234.js", true));
  EXPECT_TRUE(packed.gzip);
  EXPECT_EQ(*packed.body, "packed");
  EXPECT_FALSE(site.get(ask("/", true)).gzip) << "there is no compressed one";
}

TEST_F(SiteTest, SendsNothingThatTheBrowserHas) {
  const Site site(folder_.path("page"));
  Request again = ask("/");
  again.if_none_match = site.get(ask("/")).etag;
  const Reply reply = site.get(again);
  EXPECT_EQ(reply.status, 304U);
  EXPECT_EQ(reply.body, nullptr);
}

TEST_F(SiteTest, NoPathLeadsOutOfTheFolder) {
  const Site site(folder_.path("page"));
  for (const char* path : {"/../secret.txt", "/assets/../../secret.txt", "//etc/passwd",
                           "/%2e%2e/secret.txt", "", "/assets", "/assets/", "/nothing"})
    EXPECT_EQ(site.get(ask(path)).status, 404U) << path;
}

TEST_F(SiteTest, SaysWhereThePageWouldBe) {
  const Site site(folder_.path("none"));
  EXPECT_TRUE(site.empty());
  const Reply reply = site.get(ask("/"));
  EXPECT_EQ(reply.status, 404U);
  EXPECT_NE(reply.body->find("make viewer"), std::string::npos);
}

}  // namespace
}  // namespace sutured::gateway
