// SPDX-License-Identifier: Apache-2.0
// The scene of a running server as a PNG: its own page, in a browser without a display.
#include <algorithm>
#include <array>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <optional>
#include <string_view>
#include <system_error>
#include <vector>

#include "chromium.hpp"
#include "commands.hpp"
#include "protocol/whole_file.hpp"
#include "suture/error.hpp"

namespace suture::cli {
namespace {

using Json = nlohmann::json;

/// How the page says that it is done: client-sdk/viewer/src/snapshot.ts.
constexpr const char* kPageIsDone = R"(new Promise((done) => {
  const root = document.documentElement;
  const look = () => {
    const { ready, error, mend, errorKind } = root.dataset;
    if (!document.getElementById("app"))
      done({ kind: "other", error: document.body.innerText.trim().split("\n")[0].slice(0, 200) });
    else if (error !== undefined) done({ kind: errorKind, error, mend });
    else if (ready !== undefined) done({ kind: "ready" });
  };
  new MutationObserver(look).observe(root, { attributes: true });
  look();
}))";
/// How long a browser may take to say what its page is waiting for.
constexpr auto kLastWord = std::chrono::seconds(2);

/// What the picture is to be taken of.
struct Address {
  std::string page;   ///< without `#…`
  std::string token;  ///< empty: none
};

std::string percent_encoded(std::string_view text) {
  std::string encoded;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if ((byte >= '0' && byte <= '9') || (byte >= 'a' && byte <= 'z') ||
        (byte >= 'A' && byte <= 'Z') || c == '-' || c == '_' || c == '.') {
      encoded += c;
    } else {
      std::array<char, 4> hex{};
      std::snprintf(hex.data(), hex.size(), "%%%02X", byte);
      encoded += hex.data();
    }
  }
  return encoded;
}

/// Takes the link that a server prints, or that somebody shared: `https://host:8443/#token=…`.
Address address_in(const std::string& url) {
  const std::size_t fragment = std::min(url.find('#'), url.size());
  Address address{url.substr(0, fragment), ""};
  constexpr std::string_view kToken = "#token=";
  if (url.compare(fragment, kToken.size(), kToken) == 0)
    address.token = url.substr(fragment + kToken.size());
  const bool web = address.page.starts_with("http://") || address.page.starts_with("https://");
  if (!web || address.page.find('?') != std::string::npos)
    throw Error(ErrorCode::kBadInput, "\"" + url + "\" is no address of a server's page",
                "give the one that `sutured serve --http` prints, as http://127.0.0.1:8080/");
  return address;
}

std::string link_to(const SnapshotArguments& arguments) {
  const Address address = address_in(arguments.url);
  const std::string token =
      arguments.token.empty() ? address.token : percent_encoded(arguments.token);
  std::string link = address.page + "?snapshot=1&theme=" + percent_encoded(arguments.theme) +
                     "&view=" + percent_encoded(arguments.view);
  return token.empty() ? link : link + "#token=" + token;
}

void go_to(Chromium& browser, const std::string& url, const std::string& link) {
  const Json reached = browser.call("Page.navigate", {{"url", link}});
  const std::string fault = reached.value("errorText", std::string());
  if (fault.starts_with("net::ERR_CERT"))
    throw Error(ErrorCode::kNetwork,
                url + " has a certificate that the browser does not trust: " + fault,
                "let its certificate be one that this machine trusts");
  if (!fault.empty())
    throw Error(ErrorCode::kNoServer, "no server answers at " + url + " (" + fault + ")",
                "start one by `sutured serve SCENE --http`, or name its address by --url");
  browser.await_event("Page.loadEventFired");
}

/// Waits until the page has drawn its one picture.
void await_picture(Chromium& browser, const std::string& url) {
  const Json answer =
      browser.call("Runtime.evaluate",
                   {{"expression", kPageIsDone}, {"awaitPromise", true}, {"returnByValue", true}});
  const Json& result = answer.at("result");
  if (!result.contains("value"))
    throw Error(ErrorCode::kNetwork, "the page cannot be asked whether it is ready", "");
  const Json& page = result.at("value");
  const std::string kind = page.value("kind", std::string());
  const std::string error = page.value("error", std::string());
  const std::string mend = page.value("mend", std::string());
  if (kind == "ready") return;
  if (kind == "other")
    throw Error(ErrorCode::kNoServer, url + " answers, but not with the page of sutured: " + error,
                "see that the address is a server's, and that `make viewer` has built its page");
  if (kind == "access") throw Error(ErrorCode::kPermissionDenied, error, mend + " by --token");
  throw Error(kind == "input" ? ErrorCode::kBadInput : ErrorCode::kNetwork, error, mend);
}

/// Returns why there is no picture yet: the page's word, where it gives one.
std::string why_late(Chromium& browser) {
  if (!browser.has_page()) return {};
  browser.set_deadline(Chromium::Clock::now() + kLastWord);
  try {
    const Json answer = browser.call(
        "Runtime.evaluate", {{"expression", "document.documentElement.dataset.waits ?? \"\""},
                             {"returnByValue", true}});
    return answer.at("result").value("value", std::string());
  } catch (const TimedOut&) {
    return {};
  }
}

std::vector<std::byte> decode_base64(std::string_view text) {
  constexpr std::string_view kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::array<int, 256> value{};
  value.fill(-1);
  for (std::size_t i = 0; i < kDigits.size(); ++i)
    value[static_cast<unsigned char>(kDigits[i])] = static_cast<int>(i);
  std::vector<std::byte> bytes;
  bytes.reserve(text.size() / 4 * 3);
  std::uint32_t bits = 0;
  int held = 0;
  for (const char c : text) {
    const int digit = value[static_cast<unsigned char>(c)];
    if (digit < 0) break;
    bits = bits << 6U | static_cast<std::uint32_t>(digit);
    held += 6;
    if (held < 8) continue;
    held -= 8;
    bytes.push_back(static_cast<std::byte>(bits >> static_cast<unsigned>(held) & 0xffU));
  }
  return bytes;
}

std::vector<std::byte> picture_of(Chromium& browser, const SnapshotArguments& arguments) {
  browser.open_page();
  browser.call("Emulation.setDeviceMetricsOverride", {{"width", arguments.size.width_px},
                                                      {"height", arguments.size.height_px},
                                                      {"deviceScaleFactor", 1},
                                                      {"mobile", false}});
  go_to(browser, arguments.url, link_to(arguments));
  await_picture(browser, arguments.url);
  const Json picture = browser.call("Page.captureScreenshot", {{"format", "png"}});
  return decode_base64(picture.at("data").get_ref<const std::string&>());
}

}  // namespace

int run_snapshot(const SnapshotArguments& arguments) {
  static_cast<void>(link_to(arguments));  // a faulty address is told before the browser is sought
  const std::string program = find_chromium(arguments.browser);
  std::optional<WholeFile> file;
  const auto written = [](auto&& step) {
    try {
      step();
    } catch (const std::system_error& error) {
      throw Error(ErrorCode::kBadInput, error.what(),
                  "name a file in a folder that is there and yours");
    }
  };
  written([&] { file.emplace(arguments.file, 0666); });
  const auto patience =
      std::chrono::milliseconds(static_cast<std::int64_t>(arguments.timeout_s * 1000.0));
  try {
    Chromium browser(program, Chromium::Clock::now() + patience);
    try {
      const std::vector<std::byte> picture = picture_of(browser, arguments);
      written([&] {
        file->write(picture);
        file->commit();
      });
    } catch (const TimedOut&) {
      const std::string why = why_late(browser);
      throw Error(
          ErrorCode::kNetwork,
          "no picture within the time given: " + (why.empty() ? "the page has not come" : why),
          "see what the page shows in a browser, or wait longer by --timeout");
    }
  } catch (const Interrupted&) {
    return kInterrupted;
  }
  std::printf("%s: %d x %d pixels\n", arguments.file.c_str(), arguments.size.width_px,
              arguments.size.height_px);
  return kDone;
}

}  // namespace suture::cli
