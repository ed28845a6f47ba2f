// SPDX-License-Identifier: Apache-2.0
#include "keys/authority.hpp"

#include <openssl/bio.h>
#include <openssl/bn.h>
#include <openssl/ec.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/pkcs7.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>

#include <ctime>
#include <memory>

#include "protocol/openssl_pointers.hpp"
#include "suture/error.hpp"

namespace suture::keys {
namespace {

using ExtensionPtr = std::unique_ptr<X509_EXTENSION, Freed<X509_EXTENSION_free>>;
using RevokedPtr = std::unique_ptr<X509_REVOKED, Freed<X509_REVOKED_free>>;
using NumberPtr = std::unique_ptr<BIGNUM, Freed<BN_free>>;
using IntegerPtr = std::unique_ptr<ASN1_INTEGER, Freed<ASN1_INTEGER_free>>;
using TimePtr = std::unique_ptr<ASN1_TIME, Freed<ASN1_TIME_free>>;

[[noreturn]] void give_up(const std::string& what) {
  char reason[256] = "";
  ERR_error_string_n(ERR_get_error(), reason, sizeof reason);
  ERR_clear_error();
  throw Error(ErrorCode::kBadInput, what + " failed: " + reason,
              "see whether the site's folder is whole");
}

template <class T>
T made(T object, const char* what) {
  if (!object) give_up(what);
  return object;
}

void done(int result, const char* what) {
  if (result <= 0) give_up(what);
}

std::string text_in(BIO* bio) {
  char* data = nullptr;
  const long size = BIO_get_mem_data(bio, &data);
  return {data, static_cast<std::size_t>(size)};
}

BioPtr writing() { return made(BioPtr(BIO_new(BIO_s_mem())), "memory"); }
BioPtr reading(const std::string& text) {
  return made(BioPtr(BIO_new_mem_buf(text.data(), static_cast<int>(text.size()))), "memory");
}

CertificatePtr certificate_in(const std::string& pem) {
  return made(CertificatePtr(PEM_read_bio_X509(reading(pem).get(), nullptr, nullptr, nullptr)),
              "reading a certificate");
}
KeyPtr key_in(const std::string& pem) {
  return made(
      KeyPtr(PEM_read_bio_PrivateKey(reading(pem).get(), nullptr, nullptr, const_cast<char*>(""))),
      "reading a private key");
}

std::string pem_of(X509* certificate) {
  const BioPtr bio = writing();
  done(PEM_write_bio_X509(bio.get(), certificate), "writing a certificate");
  return text_in(bio.get());
}
std::string pem_of(EVP_PKEY* key) {
  const BioPtr bio = writing();
  done(PEM_write_bio_PrivateKey(bio.get(), key, nullptr, nullptr, 0, nullptr, nullptr),
       "writing a private key");
  return text_in(bio.get());
}

KeyPtr new_key() {
  return made(KeyPtr(EVP_PKEY_Q_keygen(nullptr, nullptr, "EC", "P-256")), "making a key");
}

IntegerPtr integer(const std::string& hexadecimal) {
  BIGNUM* raw = nullptr;
  done(BN_hex2bn(&raw, hexadecimal.c_str()), "reading a serial number");
  const NumberPtr number(raw);
  return made(IntegerPtr(BN_to_ASN1_INTEGER(number.get(), nullptr)), "a serial number");
}

void set_validity(X509* certificate, std::int64_t from_s, std::int64_t until_s) {
  done(ASN1_TIME_set(X509_getm_notBefore(certificate), from_s) != nullptr, "setting a date");
  done(ASN1_TIME_set(X509_getm_notAfter(certificate), until_s) != nullptr, "setting a date");
}

void add_name(X509_NAME* name, const char* field, const std::string& value) {
  done(X509_NAME_add_entry_by_txt(name, field, MBSTRING_UTF8,
                                  reinterpret_cast<const unsigned char*>(value.c_str()), -1, -1, 0),
       "naming a certificate");
}

void add_extension(X509* certificate, X509* issuer, int kind, const char* value) {
  X509V3_CTX context;
  X509V3_set_ctx(&context, issuer, certificate, nullptr, nullptr, 0);
  const auto extension = made(ExtensionPtr(X509V3_EXT_conf_nid(nullptr, &context, kind, value)),
                              "describing a certificate");
  done(X509_add_ext(certificate, extension.get(), -1), "describing a certificate");
}

CertificatePtr begin(const std::string& serial, EVP_PKEY* key) {
  CertificatePtr certificate = made(CertificatePtr(X509_new()), "making a certificate");
  done(X509_set_version(certificate.get(), X509_VERSION_3), "making a certificate");
  done(X509_set_serialNumber(certificate.get(), integer(serial).get()), "making a certificate");
  done(X509_set_pubkey(certificate.get(), key), "making a certificate");
  return certificate;
}

}  // namespace

std::string make_serial() {
  const NumberPtr number(BN_new());
  // 127 bits, the highest of them set: positive, and of one length.
  done(BN_rand(number.get(), 127, BN_RAND_TOP_ONE, BN_RAND_BOTTOM_ANY), "random numbers");
  char* const digits = BN_bn2hex(number.get());
  const std::string text = digits;
  OPENSSL_free(digits);
  return text;
}

KeyPair make_authority(const std::string& title, std::int64_t now_s, int days) {
  const KeyPtr key = new_key();
  const CertificatePtr certificate = begin(make_serial(), key.get());
  X509* const raw = certificate.get();
  add_name(X509_get_subject_name(raw), "O", title);
  add_name(X509_get_subject_name(raw), "CN", title + " authority");
  done(X509_set_issuer_name(raw, X509_get_subject_name(raw)), "making a certificate");
  set_validity(raw, now_s - kClockSkew_s, now_s + std::int64_t{days} * 86400);
  add_extension(raw, raw, NID_basic_constraints, "critical,CA:TRUE,pathlen:0");
  add_extension(raw, raw, NID_key_usage, "critical,keyCertSign,cRLSign,digitalSignature");
  add_extension(raw, raw, NID_subject_key_identifier, "hash");
  done(X509_sign(raw, key.get(), EVP_sha256()), "signing a certificate");
  return {pem_of(key.get()), pem_of(raw)};
}

KeyPair certify(const KeyPair& authority, const std::string& name, const std::string& serial,
                std::int64_t now_s, std::int64_t expires_s) {
  const CertificatePtr issuer = certificate_in(authority.certificate);
  const KeyPtr issuer_key = key_in(authority.key);
  const KeyPtr key = new_key();
  const CertificatePtr certificate = begin(serial, key.get());
  X509* const raw = certificate.get();
  const X509_NAME* const by = X509_get_subject_name(issuer.get());
  char title[128] = "";
  X509_NAME_get_text_by_NID(by, NID_organizationName, title, sizeof title);
  add_name(X509_get_subject_name(raw), "O", title);
  add_name(X509_get_subject_name(raw), "CN", name);
  done(X509_set_issuer_name(raw, by), "making a certificate");
  set_validity(raw, now_s - kClockSkew_s, expires_s);
  add_extension(raw, issuer.get(), NID_basic_constraints, "critical,CA:FALSE");
  add_extension(raw, issuer.get(), NID_key_usage, "critical,digitalSignature,keyAgreement");
  add_extension(raw, issuer.get(), NID_authority_key_identifier, "keyid");
  done(X509_sign(raw, issuer_key.get(), EVP_sha256()), "signing a certificate");
  return {pem_of(key.get()), pem_of(raw)};
}

std::string subject_of(const std::string& certificate) {
  const BioPtr bio = writing();
  done(X509_NAME_print_ex(bio.get(), X509_get_subject_name(certificate_in(certificate).get()), 0,
                          XN_FLAG_RFC2253),
       "reading a certificate's name");
  return text_in(bio.get());
}

std::int64_t expiry_of(const std::string& certificate) {
  std::tm parts{};
  done(ASN1_TIME_to_tm(X509_get0_notAfter(certificate_in(certificate).get()), &parts),
       "reading a certificate's dates");
  return timegm(&parts);
}

std::string sign(const KeyPair& authority, const std::string& text) {
  const CertificatePtr certificate = certificate_in(authority.certificate);
  const KeyPtr key = key_in(authority.key);
  constexpr int kInClear = PKCS7_DETACHED | PKCS7_TEXT;
  const SignedPtr envelope = made(
      SignedPtr(PKCS7_sign(certificate.get(), key.get(), nullptr, reading(text).get(), kInClear)),
      "signing a document");
  const BioPtr out = writing();
  done(SMIME_write_PKCS7(out.get(), envelope.get(), reading(text).get(), kInClear),
       "writing a signed document");
  return text_in(out.get());
}

std::string revocation_list(const KeyPair& authority, const std::vector<std::string>& serials,
                            std::int64_t now_s) {
  const CertificatePtr issuer = certificate_in(authority.certificate);
  const KeyPtr key = key_in(authority.key);
  const CrlPtr list = made(CrlPtr(X509_CRL_new()), "a list of the revoked");
  done(X509_CRL_set_version(list.get(), X509_CRL_VERSION_2), "a list of the revoked");
  done(X509_CRL_set_issuer_name(list.get(), X509_get_subject_name(issuer.get())),
       "a list of the revoked");
  const TimePtr now = made(TimePtr(ASN1_TIME_set(nullptr, now_s - kClockSkew_s)), "a date");
  done(X509_CRL_set1_lastUpdate(list.get(), now.get()), "a list of the revoked");
  // A list that ends would lock everybody out: it holds as long as the authority does.
  done(X509_CRL_set1_nextUpdate(list.get(), X509_get0_notAfter(issuer.get())),
       "a list of the revoked");
  for (const std::string& serial : serials) {
    RevokedPtr entry = made(RevokedPtr(X509_REVOKED_new()), "a list of the revoked");
    done(X509_REVOKED_set_serialNumber(entry.get(), integer(serial).get()),
         "a list of the revoked");
    done(X509_REVOKED_set_revocationDate(entry.get(), now.get()), "a list of the revoked");
    done(X509_CRL_add0_revoked(list.get(), entry.get()), "a list of the revoked");
    static_cast<void>(entry.release());  // the list's by now
  }
  done(X509_CRL_sort(list.get()), "a list of the revoked");
  done(X509_CRL_sign(list.get(), key.get(), EVP_sha256()), "signing a list of the revoked");
  const BioPtr out = writing();
  done(PEM_write_bio_X509_CRL(out.get(), list.get()), "writing a list of the revoked");
  return text_in(out.get());
}

}  // namespace suture::keys
