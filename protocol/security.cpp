// SPDX-License-Identifier: Apache-2.0
#include "protocol/security.hpp"

#include <dds/dds.h>
#include <dlfcn.h>
#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/pkcs7.h>
#include <openssl/x509.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <memory>

#include "protocol/openssl_pointers.hpp"
#include "suture/error.hpp"

namespace suture {
namespace {

using StackPtr = std::unique_ptr<STACK_OF(X509), decltype([](STACK_OF(X509) * stack) {
                                   sk_X509_free(stack);  // what it points to is not its own
                                 })>;

[[noreturn]] void refuse(const std::string& cause, const std::string& mend) {
  ERR_clear_error();
  throw Error(ErrorCode::kPermissionDenied, cause, mend);
}

/// A folder of keys, file by file.
class Folder {
 public:
  explicit Folder(std::filesystem::path path) : path_(std::move(path)) {}

  [[nodiscard]] std::string file(const char* name) const { return (path_ / name).string(); }

  [[nodiscard]] BioPtr open(const char* name) const {
    errno = 0;
    struct stat facts {};
    const std::string path = file(name);
    if (::stat(path.c_str(), &facts) != 0)
      refuse("the keys in " + path_.string() + " lack " + name + " (" + std::strerror(errno) + ")",
             "give a folder that `suture keys add` made, copied whole");
    if (!S_ISREG(facts.st_mode) || facts.st_size > kLargest)
      refuse(path + " is no file of keys", "copy the folder anew from the site's");
    BioPtr bio(BIO_new_file(path.c_str(), "r"));
    if (!bio) refuse(path + " cannot be read: " + std::strerror(errno), "give it to this user");
    return bio;
  }

  /// Refuses a key that others may read: whoever read it already is its holder as well. systemd
  /// hands a service its credentials by an access control list, whose mask shows as the group's
  /// bits; the folder is the service's own.
  void check_key_is_private() const {
    struct stat facts {};
    const std::string path = file(key_files::kKey);
    const char* const credentials = std::getenv("CREDENTIALS_DIRECTORY");
    const bool handed_in = credentials != nullptr && path_ == credentials;
    const mode_t others = handed_in ? S_IRWXO : S_IRWXG | S_IRWXO;
    if (::stat(path.c_str(), &facts) != 0 || (facts.st_mode & others) == 0) return;
    refuse("the private key " + path + " is open to others",
           "`chmod 600 " + path +
               "`, and where others may have read it, `suture keys renew --revoke-old` it");
  }

  template <class Ptr, class Read>
  [[nodiscard]] Ptr parsed(const char* name, Read&& read) const {
    const BioPtr bio = open(name);
    Ptr result(read(bio.get()));
    if (!result) refuse(file(name) + " is damaged", "copy the folder anew from the site's");
    return result;
  }

  /// Returns the text that the authority signed.
  [[nodiscard]] std::string signed_text(const char* name, X509* authority) const {
    const BioPtr bio = open(name);
    BIO* raw_content = nullptr;
    const SignedPtr envelope(SMIME_read_PKCS7(bio.get(), &raw_content));
    const BioPtr content(raw_content);
    const BioPtr text(BIO_new(BIO_s_mem()));
    const StackPtr signers(sk_X509_new_null());
    sk_X509_push(signers.get(), authority);
    // As the plugin of DDS Security does: the authority itself signed, nobody in between.
    if (!envelope || PKCS7_verify(envelope.get(), signers.get(), nullptr, content.get(), text.get(),
                                  PKCS7_TEXT | PKCS7_NOVERIFY | PKCS7_NOINTERN) != 1)
      refuse(file(name) + " is not what this site's authority signed",
             "it was changed, or is of another authority: copy the folder anew from the site's");
    char* data = nullptr;
    const long size = BIO_get_mem_data(text.get(), &data);
    return {data, static_cast<std::size_t>(size)};
  }

 private:
  static constexpr off_t kLargest = 1 << 20;
  std::filesystem::path path_;
};

std::int64_t unix_s(const ASN1_TIME* time) {
  std::tm parts{};
  if (ASN1_TIME_to_tm(time, &parts) != 1) return 0;
  return timegm(&parts);
}

std::string common_name(X509* certificate) {
  char text[128] = "";
  X509_NAME_get_text_by_NID(X509_get_subject_name(certificate), NID_commonName, text, sizeof text);
  return text;
}

/// Returns what stands in each `<tag>…</tag>`.
std::vector<std::string> contents(std::string_view xml, const std::string& tag) {
  const std::string open = "<" + tag + ">", close = "</" + tag + ">";
  std::vector<std::string> found;
  for (std::size_t at = 0; (at = xml.find(open, at)) != std::string_view::npos;) {
    at += open.size();
    const std::size_t end = xml.find(close, at);
    if (end == std::string_view::npos) break;
    found.emplace_back(xml.substr(at, end - at));
  }
  return found;
}

std::int64_t unix_s(const std::string& xml_date) {
  std::tm parts{};
  if (strptime(xml_date.c_str(), "%Y-%m-%dT%H:%M:%S", &parts) == nullptr) return 0;
  return timegm(&parts);
}

// Debian keeps the plugins in a folder beside the library; elsewhere the loader finds them.
std::string plugin(const std::string& name) {
  Dl_info facts{};
  if (dladdr(reinterpret_cast<const void*>(&dds_create_participant), &facts) != 0 &&
      facts.dli_fname != nullptr) {
    std::error_code ignored;
    const std::filesystem::path library =
        std::filesystem::canonical(facts.dli_fname, ignored).parent_path();
    const std::filesystem::path beside =
        library / "libddsc0debian" / ("libdds_security_" + name + ".so");
    if (std::filesystem::exists(beside, ignored)) return beside.string();
  }
  return "dds_security_" + name;
}

std::vector<std::pair<std::string, std::string>> properties_of(const Folder& folder) {
  const auto file = [&](const char* name) { return "file:" + folder.file(name); };
  return {
      {"dds.sec.auth.library.path", plugin("auth")},
      {"dds.sec.auth.library.init", "init_authentication"},
      {"dds.sec.auth.library.finalize", "finalize_authentication"},
      {"dds.sec.crypto.library.path", plugin("crypto")},
      {"dds.sec.crypto.library.init", "init_crypto"},
      {"dds.sec.crypto.library.finalize", "finalize_crypto"},
      {"dds.sec.access.library.path", plugin("ac")},
      {"dds.sec.access.library.init", "init_access_control"},
      {"dds.sec.access.library.finalize", "finalize_access_control"},
      {"dds.sec.auth.identity_ca", file(key_files::kAuthority)},
      {"dds.sec.auth.identity_certificate", file(key_files::kCertificate)},
      {"dds.sec.auth.private_key", file(key_files::kKey)},
      {"org.eclipse.cyclonedds.sec.auth.crl", file(key_files::kRevoked)},
      {"dds.sec.access.permissions_ca", file(key_files::kAuthority)},
      {"dds.sec.access.governance", file(key_files::kGovernance)},
      {"dds.sec.access.permissions", file(key_files::kPermissions)},
  };
}

}  // namespace

std::string tool_partition(std::string_view tool) { return kToolMark + std::string(tool); }

bool Identity::may_drive(std::string_view tool) const noexcept {
  return std::any_of(tools.begin(), tools.end(),
                     [&](const std::string& own) { return own == "*" || own == tool; });
}

std::string utc_text(std::int64_t unix_s, const char* format) {
  const std::time_t time = unix_s;
  std::tm parts{};
  gmtime_r(&time, &parts);
  char text[32];
  std::strftime(text, sizeof text, format, &parts);
  return text;
}

std::string date_text(std::int64_t unix_s) { return utc_text(unix_s, "%Y-%m-%d"); }

std::string security_folder(const std::string& chosen) {
  if (!chosen.empty()) return chosen == "off" ? "" : chosen;
  // concurrency: read once at set-up; nothing in this library calls setenv.
  const char* wished = std::getenv("SUTURE_SECURITY");  // NOLINT(concurrency-mt-unsafe)
  return wished == nullptr || std::string_view(wished) == "off" ? "" : wished;
}

Identity read_identity(const std::string& path) {
  std::error_code fault;
  const std::filesystem::path absolute = std::filesystem::canonical(path, fault);
  if (fault || !std::filesystem::is_directory(absolute))
    refuse("there is no folder of keys " + path,
           "make one with `suture keys add`, and copy it whole");
  const Folder folder(absolute);
  folder.check_key_is_private();
  const auto certificate_in = [](BIO* bio) {
    return PEM_read_bio_X509(bio, nullptr, nullptr, nullptr);
  };
  const auto authority = folder.parsed<CertificatePtr>(key_files::kAuthority, certificate_in);
  const auto certificate = folder.parsed<CertificatePtr>(key_files::kCertificate, certificate_in);
  const auto key = folder.parsed<KeyPtr>(key_files::kKey, [](BIO* bio) {
    return PEM_read_bio_PrivateKey(bio, nullptr, nullptr, const_cast<char*>(""));
  });
  const auto revoked = folder.parsed<CrlPtr>(key_files::kRevoked, [](BIO* bio) {
    return PEM_read_bio_X509_CRL(bio, nullptr, nullptr, nullptr);
  });

  Identity identity;
  identity.folder = absolute.string();
  identity.name = common_name(certificate.get());
  const std::string whose = "the certificate of \"" + identity.name + "\"";
  if (X509_verify(certificate.get(), X509_get0_pubkey(authority.get())) != 1)
    refuse(whose + " is not of the authority \"" + common_name(authority.get()) + "\" beside it",
           "copy the folder anew from the site's");
  if (X509_check_private_key(certificate.get(), key.get()) != 1)
    refuse(whose + " and " + folder.file(key_files::kKey) + " do not belong together",
           "copy the folder anew from the site's");
  if (X509_CRL_verify(revoked.get(), X509_get0_pubkey(authority.get())) != 1)
    refuse(folder.file(key_files::kRevoked) + " is not what this site's authority signed",
           "copy it anew from the site's folder");
  X509_REVOKED* entry = nullptr;
  if (X509_CRL_get0_by_cert(revoked.get(), &entry, certificate.get()) == 1)
    refuse(
        whose + " is revoked",
        "copy the folder anew from the site's where it was renewed, or ask for another identity");
  const std::int64_t now = std::time(nullptr);
  identity.expires_s = unix_s(X509_get0_notAfter(certificate.get()));
  if (identity.expires_s < now)
    refuse(whose + " expired on " + date_text(identity.expires_s),
           "`suture keys renew SITE " + identity.name + "` at the site, and copy the folder anew");
  if (unix_s(X509_get0_notBefore(certificate.get())) > now)
    refuse(whose + " holds only from " + date_text(unix_s(X509_get0_notBefore(certificate.get()))) +
               " on",
           "set this machine's clock");

  static_cast<void>(folder.signed_text(key_files::kGovernance, authority.get()));
  const std::string permissions = folder.signed_text(key_files::kPermissions, authority.get());
  for (const std::string& date : contents(permissions, "not_after"))
    identity.expires_s = std::min(identity.expires_s, unix_s(date));
  if (identity.expires_s < now)
    refuse(
        "the permissions of \"" + identity.name + "\" expired on " + date_text(identity.expires_s),
        "`suture keys renew SITE " + identity.name + "` at the site, and copy the folder anew");
  for (const std::string& partition : contents(permissions, "partition"))
    if (partition.starts_with(kToolMark)) identity.tools.push_back(partition.substr(1));
  std::sort(identity.tools.begin(), identity.tools.end());
  identity.tools.erase(std::unique(identity.tools.begin(), identity.tools.end()),
                       identity.tools.end());
  identity.properties = properties_of(folder);
  return identity;
}

}  // namespace suture
