// SPDX-License-Identifier: Apache-2.0
#include "keys/site.hpp"

#include <cstdio>
#include <ctime>

#include "commands.hpp"
#include "protocol/security.hpp"

namespace suture::cli {
namespace {

constexpr std::int64_t kDay_s = 86400;
constexpr int kAuthorityDays = 3650, kIdentityDays = 365;

std::int64_t seconds_of(const KeysArguments& arguments) {
  return kDay_s * (arguments.days > 0 ? arguments.days : kIdentityDays);
}

std::string joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ",") + word;
  return text;
}

void say_what_to_do(const std::filesystem::path& folder) {
  std::printf(
      "%s\ncopy this folder to where it is used, by a safe way, and give it there: "
      "--security FOLDER, or SUTURE_SECURITY=FOLDER\n",
      folder.c_str());
}

void say_what_to_do_with_the_list(const std::string& site) {
  std::printf(
      "copy %s/%s into the folders of keys in use, the servers' first, and start the servers "
      "again\n",
      site.c_str(), key_files::kRevoked);
}

}  // namespace

int run_keys_init(const KeysArguments& arguments) {
  const keys::Protection protection = arguments.protection == "sign" ? keys::Protection::kSign
                                      : arguments.protection == "encrypt"
                                          ? keys::Protection::kEncrypt
                                          : keys::Protection::kEncryptWithOrigin;
  keys::Site::create(arguments.site, arguments.title,
                     arguments.days > 0 ? arguments.days : kAuthorityDays, protection);
  std::printf("%s is a site: keep it off the network, and a copy of it in a safe\n",
              arguments.site.c_str());
  return kDone;
}

int run_keys_add(const KeysArguments& arguments) {
  keys::Rights rights;
  for (const std::string& role : arguments.roles) rights.roles.push_back(keys::role_of(role));
  rights.tools = arguments.tools;
  rights.domain = arguments.domain;
  rights.session = arguments.session;
  say_what_to_do(keys::Site(arguments.site).add(arguments.name, rights, seconds_of(arguments)));
  return kDone;
}

int run_keys_renew(const KeysArguments& arguments) {
  const auto old_keys = arguments.revoke_old ? keys::OldKeys::kRevoke : keys::OldKeys::kHold;
  say_what_to_do(keys::Site(arguments.site).renew(arguments.name, seconds_of(arguments), old_keys));
  if (arguments.revoke_old) {
    std::printf("the keys that it had are revoked: ");
    say_what_to_do_with_the_list(arguments.site);
  } else {
    std::printf("the keys that it had hold until they expire (--revoke-old withdraws them)\n");
  }
  return kDone;
}

int run_keys_revoke(const KeysArguments& arguments) {
  keys::Site(arguments.site).revoke(arguments.name);
  std::printf("\"%s\" is revoked: ", arguments.name.c_str());
  say_what_to_do_with_the_list(arguments.site);
  return kDone;
}

int run_keys_list(const KeysArguments& arguments) {
  const keys::Site site(arguments.site);
  std::printf("%-20s %-20s %-20s %-10s %-16s %s\n", "name", "roles", "tools", "until", "where",
              "state");
  const std::int64_t now = std::time(nullptr);
  for (const keys::Entry& entry : site.entries()) {
    std::vector<std::string> roles;
    for (const keys::Role role : entry.rights.roles) roles.emplace_back(keys::name_of(role));
    std::string where = entry.rights.domain < 0 ? "" : std::to_string(entry.rights.domain);
    if (!entry.rights.session.empty()) where += "/" + entry.rights.session;
    std::printf("%-20s %-20s %-20s %-10s %-16s %s\n", entry.name.c_str(), joined(roles).c_str(),
                entry.rights.tools.empty() ? "-" : joined(entry.rights.tools).c_str(),
                date_text(entry.expires_s).c_str(), where.empty() ? "everywhere" : where.c_str(),
                entry.revoked                                          ? "revoked"
                : entry.expires_s < now                                ? "expired"
                : !std::filesystem::exists(site.folder_of(entry.name)) ? "no folder: renew"
                                                                       : "valid");
  }
  return kDone;
}

}  // namespace suture::cli
