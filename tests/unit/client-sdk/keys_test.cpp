// SPDX-License-Identifier: GPL-3.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>

#include "keys/documents.hpp"
#include "keys/site.hpp"
#include "protocol/participant.hpp"
#include "protocol/security.hpp"
#include "support/fault_of.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"

namespace suture::keys {
namespace {

namespace fs = std::filesystem;
using sutured::testing::fault_of;
using sutured::testing::read_file;
using sutured::testing::TemporaryFolder;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr std::int64_t kDay_s = 86400;

mode_t mode_of(const fs::path& path) {
  struct stat facts {};
  EXPECT_EQ(::stat(path.c_str(), &facts), 0) << path;
  return facts.st_mode & 07777;
}

class Keys : public ::testing::Test {
 protected:
  Keys() { Site::create(site_, "ward 7", 3650, Protection::kEncryptWithOrigin); }

  static Rights device(const std::string& tool) { return {{Role::kDevice}, {tool}, -1, ""}; }
  std::string add(const std::string& name, const Rights& rights, std::int64_t seconds = kDay_s) {
    return Site(site_).add(name, rights, seconds);
  }
  [[nodiscard]] static std::string fault_in(const std::string& folder) {
    return fault_of([&] { static_cast<void>(read_identity(folder)); });
  }

  TemporaryFolder folder_;
  std::string site_ = folder_.path("site");
};

TEST_F(Keys, AnIdentityIsReadAsItWasGiven) {
  const std::string folder = add("left", {{Role::kDevice}, {"driver", "probe"}, -1, ""});
  const Identity identity = read_identity(folder);
  EXPECT_EQ(identity.name, "left");
  EXPECT_THAT(identity.tools, ElementsAre("driver", "probe"));
  EXPECT_TRUE(identity.may_drive("driver"));
  EXPECT_FALSE(identity.may_drive("assistant"));
  EXPECT_NEAR(static_cast<double>(identity.expires_s - std::time(nullptr)), kDay_s, 60.0);
}

TEST_F(Keys, NoKeyIsOpenToOthers) {
  const fs::path folder = add("left", device("driver"));
  EXPECT_EQ(mode_of(site_), 0700U);
  EXPECT_EQ(mode_of(site_ + "/authority.key.pem"), 0600U);
  EXPECT_EQ(mode_of(folder), 0700U);
  EXPECT_EQ(mode_of(folder / key_files::kKey), 0600U);
}

TEST_F(Keys, AKeyOpenToOthersIsRefusedWithTheMend) {
  const fs::path folder = add("left", device("driver"));
  ::chmod((folder / key_files::kKey).c_str(), 0640);
  EXPECT_THAT(fault_in(folder), HasSubstr("chmod 600"));
  EXPECT_THAT(fault_in(folder), HasSubstr("suture keys renew --revoke-old"));
  ::chmod((folder / key_files::kKey).c_str(), 0600);
  EXPECT_EQ(fault_in(folder), "");
  ::chmod((site_ + "/authority.key.pem").c_str(), 0604);
  EXPECT_THAT(fault_of([&] { add("right", device("probe")); }), HasSubstr("open to others"));
}

TEST_F(Keys, AServiceMayBeHandedItsKeyByAnAccessList) {
  const fs::path folder = add("left", device("driver"));
  const fs::path other = add("right", device("probe"));
  for (const fs::path& each : {folder, other}) ::chmod((each / key_files::kKey).c_str(), 0440);
  ::setenv("CREDENTIALS_DIRECTORY", folder.c_str(), 1);
  EXPECT_EQ(fault_in(folder), "") << "the list's mask shows as the group's bits";
  EXPECT_THAT(fault_in(other), HasSubstr("open to others"));
  ::chmod((folder / key_files::kKey).c_str(), 0444);
  EXPECT_THAT(fault_in(folder), HasSubstr("open to others"));
  ::unsetenv("CREDENTIALS_DIRECTORY");
}

TEST_F(Keys, WhatIsRefusedLeavesTheSiteAsItWas) {
  add("left", device("driver"));
  const std::string before = read_file(site_ + "/register.json");
  EXPECT_THAT(fault_of([&] { add("left", device("driver")); }), HasSubstr("has an identity"));
  EXPECT_THAT(fault_of([&] { add("../left", device("driver")); }), HasSubstr("names no identity"));
  EXPECT_THAT(fault_of([&] {
                add("d", {{Role::kDevice}, {}, -1, ""});
              }),
              HasSubstr("without a tool"));
  EXPECT_THAT(fault_of([&] { add("d", device("dri*er")); }), HasSubstr("names no tool"));
  EXPECT_THAT(fault_of([&] {
                add("d", {{Role::kViewer}, {"driver"}, -1, ""});
              }),
              HasSubstr("only a device"));
  EXPECT_THAT(fault_of([&] { add("d", {{Role::kViewer}, {}, 3, ""}); }), HasSubstr("even number"));
  EXPECT_THAT(fault_of([&] { add("d", device("driver"), 20000 * kDay_s); }),
              HasSubstr("authority ends"));
  EXPECT_THAT(fault_of([&] { Site(site_).renew("nobody", kDay_s); }), HasSubstr("no identity"));
  EXPECT_EQ(read_file(site_ + "/register.json"), before);
  EXPECT_FALSE(fs::exists(site_ + "/identities/d"));
}

TEST_F(Keys, RenewingGivesANewKeyAndTheSameRights) {
  const fs::path folder = add("left", device("driver"), 60);
  const std::string key = read_file(folder / key_files::kKey);
  Site(site_).renew("left", 2 * kDay_s);
  EXPECT_NE(read_file(folder / key_files::kKey), key);
  EXPECT_THAT(read_identity(folder).tools, ElementsAre("driver"));
  EXPECT_GT(read_identity(folder).expires_s, std::time(nullptr) + kDay_s);
}

TEST_F(Keys, NobodyElsesFolderIsRemoved) {
  const fs::path other = add("left.new", device("probe"));
  add("left", device("driver"));
  Site(site_).renew("left", kDay_s);
  EXPECT_EQ(fault_in(other), "");
  const std::string next = folder_.path("next");
  fs::create_directory(next + ".new");
  std::ofstream(next + ".new/notes") << "mine";
  Site::create(next, "ward 8", 3650, Protection::kSign);
  EXPECT_EQ(read_file(next + ".new/notes"), "mine");
  for (const fs::path& folder : {fs::path(folder_.path("")), fs::path(site_) / "identities"})
    for (const auto& entry : fs::directory_iterator(folder))
      EXPECT_NE(entry.path().filename().string().front(), '.') << entry.path();
}

TEST_F(Keys, ASiteIsMadeInANewOrAnEmptyFolder) {
  const std::string tab = folder_.path("tab");
  Site::create(tab + "/", "tab", 3650, Protection::kSign);
  EXPECT_TRUE(Site(tab + "/").entries().empty());
  const std::string empty = folder_.path("empty");
  fs::create_directory(empty);
  Site::create(empty + "//", "empty", 3650, Protection::kSign);
  EXPECT_TRUE(Site(empty).entries().empty());
  EXPECT_THAT(fault_of([&] { Site::create(empty, "again", 3650, Protection::kSign); }),
              HasSubstr("not empty"));
}

TEST_F(Keys, RevokingWithdrawsEveryCertificateOfAName) {
  const fs::path folder = add("left", device("driver"));
  fs::copy(folder, folder_.path("first"));
  Site(site_).renew("left", kDay_s);
  const fs::path other = add("right", device("probe"));
  Site(site_).revoke("left");
  EXPECT_THAT(fault_in(folder), HasSubstr("revoked"));
  fs::copy_file(fs::path(site_) / key_files::kRevoked,
                fs::path(folder_.path("first")) / key_files::kRevoked,
                fs::copy_options::overwrite_existing);
  EXPECT_THAT(fault_in(folder_.path("first")), HasSubstr("revoked"));
  EXPECT_EQ(fault_in(other), "");
  EXPECT_THAT(fault_of([&] { Site(site_).renew("left", kDay_s); }), HasSubstr("revoked"));
  EXPECT_THAT(fault_of([&] { add("left", device("driver")); }), HasSubstr("revoked"));
  // Who comes later knows it too.
  EXPECT_EQ(read_file(fs::path(add("third", device("probe"))) / key_files::kRevoked),
            read_file(fs::path(site_) / key_files::kRevoked));
}

TEST_F(Keys, RenewingMayRevokeTheKeysBefore) {
  const fs::path list = fs::path(site_) / key_files::kRevoked;
  const fs::path folder = add("left", device("driver"));
  const fs::path other = add("right", device("probe"));
  const auto fault_of_copy = [&](const char* copy) {
    fs::copy_file(list, fs::path(folder_.path(copy)) / key_files::kRevoked,
                  fs::copy_options::overwrite_existing);
    return fault_in(folder_.path(copy));
  };
  fs::copy(folder, folder_.path("first"));
  Site(site_).renew("left", kDay_s);
  fs::copy(folder, folder_.path("second"));
  EXPECT_EQ(fault_of_copy("first"), "") << "nobody said that it should end";
  Site(site_).renew("left", kDay_s, OldKeys::kRevoke);
  EXPECT_THAT(fault_of_copy("first"), HasSubstr("revoked"));
  EXPECT_THAT(fault_of_copy("second"), HasSubstr("revoked"));
  EXPECT_EQ(fault_in(folder), "");
  EXPECT_EQ(fault_in(other), "");
  for (const fs::path& each : {folder, other})
    EXPECT_EQ(read_file(each / key_files::kRevoked), read_file(list)) << each;
  // The register knows it: no later list forgets it, and the name is still given.
  Site(site_).renew("left", kDay_s);
  Site(site_).revoke("right");
  EXPECT_THAT(fault_of_copy("second"), HasSubstr("revoked"));
  EXPECT_EQ(fault_in(folder), "");
}

TEST_F(Keys, ARegisterOfBeforeKeysWereWithdrawnIsRead) {
  add("left", device("driver"));
  std::string text = read_file(site_ + "/register.json");
  const std::size_t name = text.find("\"withdrawn_serials\"");
  ASSERT_NE(name, std::string::npos);
  const std::size_t comma = text.rfind(',', name);  // it is the last one
  text.erase(comma, text.find(']', name) + 1 - comma);
  std::ofstream(site_ + "/register.json") << text;
  EXPECT_TRUE(Site(site_).entries().at(0).withdrawn_serials.empty()) << text;
}

TEST_F(Keys, EachDamageIsNamed) {
  const fs::path folder = add("left", device("driver"));
  const fs::path other = add("right", device("probe"));
  const auto damaged = [&](const std::function<void(const fs::path&)>& how) {
    const fs::path copy = folder_.path("copy");
    fs::remove_all(copy);
    fs::copy(folder, copy);
    how(copy);
    return fault_in(copy);
  };
  for (const char* name : {key_files::kAuthority, key_files::kCertificate, key_files::kKey,
                           key_files::kGovernance, key_files::kPermissions, key_files::kRevoked}) {
    EXPECT_THAT(damaged([&](const fs::path& copy) { fs::remove(copy / name); }),
                HasSubstr(std::string("lack ") + name));
    EXPECT_THAT(damaged([&](const fs::path& copy) { std::ofstream(copy / name) << "nonsense"; }),
                HasSubstr(name));
  }
  EXPECT_THAT(damaged([&](const fs::path& copy) {
                fs::copy_file(other / key_files::kKey, copy / key_files::kKey,
                              fs::copy_options::overwrite_existing);
              }),
              HasSubstr("do not belong together"));
  EXPECT_THAT(damaged([&](const fs::path& copy) {
                std::string text = read_file(copy / key_files::kPermissions);
                text.replace(text.find("@driver"), 7, "@probes");
                std::ofstream(copy / key_files::kPermissions) << text;
              }),
              HasSubstr("not what this site's authority signed"));
}

TEST_F(Keys, AnotherSitesCertificateIsNamedSo) {
  const std::string elsewhere = folder_.path("elsewhere");
  Site::create(elsewhere, "ward 7", 3650, Protection::kEncrypt);
  const fs::path stranger = Site(elsewhere).add("left", device("driver"), kDay_s);
  const fs::path folder = add("left", device("driver"));
  fs::copy_file(folder / key_files::kAuthority, stranger / key_files::kAuthority,
                fs::copy_options::overwrite_existing);
  EXPECT_THAT(fault_in(stranger), HasSubstr("not of the authority \"ward 7 authority\""));
}

TEST_F(Keys, ASiteIsWorkedOnByOneProcess) {
  const Site first(site_);
  EXPECT_THAT(fault_of([&] { const Site second(site_); }), HasSubstr("another process"));
}

TEST_F(Keys, ARightToEverySessionIsNoneToATool) {
  const std::string permissions = permissions_xml("CN=a", {{Role::kViewer}, {}, -1, ""}, 0, 1);
  EXPECT_THAT(permissions, HasSubstr("<partition>[!@]*</partition>"));
  EXPECT_THAT(permissions, Not(HasSubstr("<partition>*</partition>")));
  EXPECT_THAT(permissions, Not(HasSubstr("<publish>")));
  EXPECT_THAT(permissions_xml("CN=a", {{Role::kDevice}, {"driver"}, 4, "class-a"}, 0, 1),
              HasSubstr("<partition>class-a</partition><partition>@driver</partition>"));
}

TEST_F(Keys, AParticipantIsToldWhatItsKeysLack) {
  ParticipantOptions options = sutured::testing::own_session();
  options.security = add("left", device("driver"));
  options.tool = "probe";
  EXPECT_THAT(fault_of([&] { const Participant control(options, Channel::kControl); }),
              HasSubstr("no right to the tool \"probe\" (but to: driver)"));
  options.tool = "driver";
  const Participant control(options, Channel::kControl);
  EXPECT_EQ(control.identity()->name, "left");
  options.security = "";
  options.session = "@driver";
  EXPECT_THAT(fault_of([&] { const Participant claims(options, Channel::kControl); }),
              HasSubstr("session name"));
}

}  // namespace
}  // namespace suture::keys
