// SPDX-License-Identifier: GPL-3.0-or-later
// `suture snapshot` against real servers, drawn by a real Chromium: the picture, and every way to
// none.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <png.h>
#include <signal.h>

#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <stdexcept>

#include "gateway/gateway.hpp"
#include "support/process.hpp"
#include "support/program.hpp"
#include "support/temporary_folder.hpp"
#include "support/test_session.hpp"

namespace sutured {
namespace {

namespace fs = std::filesystem;
using testing::eventually;
using ::testing::HasSubstr;
using testing::own_session;
using testing::Process;
using testing::ProgramResult;

constexpr const char* kScene = SUTURED_SOURCE_DIR "/server/scenes/anastomosis/scene.toml";
/// printf %s 'open-sesame_7' | sha256sum
constexpr const char* kTokenDigest =
    "36783fa63452becf6269509438e9f7c74680c2a8aa6ad73102e69da2e3246643";
constexpr const char* kPage = SUTURED_BINARY_DIR "/../viewer";

/// A decoded picture, 8 bits of red, green and blue a pixel.
struct Picture {
  int width = 0, height = 0;
  std::vector<png_byte> rgb;

  explicit Picture(const std::string& file) {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    if (png_image_begin_read_from_file(&image, file.c_str()) == 0)
      throw std::runtime_error(file + ": " + image.message);
    image.format = PNG_FORMAT_RGB;
    width = static_cast<int>(image.width);
    height = static_cast<int>(image.height);
    rgb.resize(PNG_IMAGE_SIZE(image));
    EXPECT_NE(png_image_finish_read(&image, nullptr, rgb.data(), 0, nullptr), 0) << image.message;
  }
  /// Share of the pixels of the left or right half that have the warm colours of tissue.
  [[nodiscard]] double tissue(bool right) const {
    int found = 0;
    for (int y = 0; y < height; ++y)
      for (int x = right ? width / 2 : 0; x < (right ? width : width / 2); ++x) {
        const png_byte* const p = &rgb[3 * static_cast<std::size_t>(y * width + x)];
        if (p[0] > 90 && p[0] > p[1] + 18 && p[1] >= p[2] - 30 && p[0] > p[2] + 24) ++found;
      }
    return 2.0 * found / (width * height);
  }
  [[nodiscard]] int corner_brightness() const { return rgb[0] + rgb[1] + rgb[2]; }
};

/// What does not need a browser, and what all share: commands whose temporary files lie in a folder
/// of the test.
class SnapshotCommand : public ::testing::Test {
 protected:
  SnapshotCommand() {
    fs::create_directory(temporary());
    ::setenv("TMPDIR", temporary().c_str(), 1);
  }
  ~SnapshotCommand() override {
    EXPECT_TRUE(fs::is_empty(temporary())) << "the browser's folder is left";
    for (const auto& entry : fs::directory_iterator(folder_.path("")))
      EXPECT_EQ(entry.path().filename().string().find("picture.png."), std::string::npos)
          << "half a picture is left: " << entry.path();
  }

  [[nodiscard]] std::string temporary() const { return folder_.path("tmp"); }
  [[nodiscard]] std::string picture() const { return folder_.path("picture.png"); }
  [[nodiscard]] std::vector<std::string> words(std::vector<std::string> more = {}) const {
    std::vector<std::string> all{SUTURE_CLI, "snapshot", picture()};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  [[nodiscard]] ProgramResult take(std::vector<std::string> more = {}) const {
    return testing::run_program(words(std::move(more)));
  }
  /// A browser that is a shell script; writes its process id to the file "pid".
  [[nodiscard]] std::string browser(const std::string& script) const {
    const std::string path = folder_.write(
        "browser", "#!/bin/sh\necho $$ >" + folder_.path("pid.new") + "\nmv " +
                       folder_.path("pid.new") + " " + folder_.path("pid") + "\n" + script + "\n");
    fs::permissions(path, fs::perms::owner_all);
    return path;
  }
  /// Waits for the browser of `browser()` to have begun.
  [[nodiscard]] pid_t browser_pid() const {
    EXPECT_TRUE(eventually([&] { return fs::exists(folder_.path("pid")); }));
    return static_cast<pid_t>(std::atoi(testing::read_file(folder_.path("pid")).c_str()));
  }
  /// Whether a process of that group is left.
  static bool group_lives(pid_t group) { return ::kill(-group, 0) == 0 || errno != ESRCH; }

  testing::TemporaryFolder folder_;
};

/// Needs Chromium and the page.
class Snapshot : public SnapshotCommand {
 protected:
  void SetUp() override {
    if (std::string(CHROMIUM).empty()) GTEST_SKIP() << "no Chromium is installed";
    if (!fs::exists(std::string(kPage) + "/index.html"))
      GTEST_SKIP() << "the page was not built: `make viewer`";
  }
};

/// `sutured serve` with its gateway at a free port.
class Server {
 public:
  explicit Server(const std::vector<std::string>& more = {}) : process_(words(more)) {
    const std::string& said = process_.read_until("viewer at http");
    // The address may come in the next piece of the log.
    process_.read_until("/\n");
    std::istringstream(said.substr(said.find("viewer at ") + 10)) >> url_;
  }
  [[nodiscard]] const std::string& url() const { return url_; }

 private:
  static std::vector<std::string> words(const std::vector<std::string>& more) {
    std::vector<std::string> all{SUTURED_PROGRAM,
                                 "serve",
                                 kScene,
                                 "--http",
                                 "127.0.0.1:0",
                                 "--http-page",
                                 kPage,
                                 "--domain",
                                 std::to_string(own_session().domain),
                                 "--session",
                                 own_session().session};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  Process process_;
  std::string url_;
};

/// The gateway of a session in which no server is: connected, and without a scene.
std::unique_ptr<gateway::Gateway> gateway_without_scene() {
  gateway::Gateway::Options options;
  options.port = 0;
  options.page = kPage;
  return std::make_unique<gateway::Gateway>(own_session(), options);
}

TEST_F(Snapshot, ShowsTheVesselsInTheSizeViewAndThemeAskedFor) {
  const Server server;
  ProgramResult result = take({"--url", server.url(), "--size", "640x400"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.out, picture() + ": 640 x 400 pixels\n");
  EXPECT_EQ(testing::read_file(picture()).substr(0, 8), "\x89PNG\r\n\x1a\n");
  const Picture overview(picture());
  EXPECT_EQ(overview.width, 640);
  EXPECT_EQ(overview.height, 400);
  for (const bool right : {false, true}) {
    EXPECT_GT(overview.tissue(right), 0.04);
    EXPECT_LT(overview.tissue(right), 0.6);
  }
  EXPECT_GT(overview.corner_brightness(), 3 * 160);

  result =
      take({"--url", server.url(), "--size", "640x400", "--view", "Needle", "--theme", "dark"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const Picture needle(picture());
  EXPECT_LT(needle.corner_brightness(), 3 * 90);
  // From near, the tissue fills more of it.
  EXPECT_GT(needle.tissue(false) + needle.tissue(true),
            1.2 * (overview.tissue(false) + overview.tissue(true)));
}

TEST_F(Snapshot, NamesTheViewsWhereThereIsNoSuchAndLeavesTheOldPicture) {
  const Server server;
  std::ofstream(picture()) << "old";
  const ProgramResult result = take({"--url", server.url(), "--view", "nose\"&x=<b>"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, HasSubstr("there is no view \"nose\"&x=<b>\""));
  EXPECT_THAT(result.err, HasSubstr("overview, front, side, top, needle"));
  EXPECT_EQ(testing::read_file(picture()), "old");
}

TEST_F(Snapshot, BringsTheTokenThatAServerAsksFor) {
  const std::string tokens =
      folder_.write("tokens.toml", "[[token]]\nname = \"test\"\nsha256 = \"" +
                                       std::string(kTokenDigest) + "\"\nrights = []\n");
  const Server server({"--http-tokens", tokens});
  const std::vector<std::string> at{"--url", server.url(), "--size", "320x200"};
  ProgramResult result = take(at);
  EXPECT_EQ(result.exit_code, 6);
  EXPECT_THAT(result.err, HasSubstr("the token is missing or wrong"));
  EXPECT_THAT(result.err, HasSubstr("--token"));
  result = take({"--url", server.url() + "#token=open", "--size", "320x200"});
  EXPECT_EQ(result.exit_code, 6);
  EXPECT_FALSE(fs::exists(picture()));

  ::setenv("SUTURE_TOKEN", "open-sesame_7", 1);
  result = take(at);
  ::unsetenv("SUTURE_TOKEN");
  EXPECT_EQ(result.exit_code, 0) << result.err;
  result = take({"--url", server.url() + "#token=open-sesame_7", "--size", "320x200"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
}

TEST_F(Snapshot, SaysThatThereIsNoServer) {
  // Port 9, discard: nobody of ours is there.
  const ProgramResult result = take({"--url", "http://127.0.0.1:9/"});
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_THAT(result.err, HasSubstr("no server answers at http://127.0.0.1:9/"));
  EXPECT_FALSE(fs::exists(picture()));
}

TEST_F(Snapshot, SaysThatThereIsNoSceneYet) {
  const auto gateway = gateway_without_scene();
  // On a busy machine the browser may not be ready by then, and that is told instead.
  ProgramResult result;
  for (const char* seconds : {"5", "15", "60"}) {
    result = take({"--url", gateway->url(), "--timeout", seconds});
    EXPECT_EQ(result.exit_code, 1);
    if (result.err.find("has sent no scene") != std::string::npos) break;
  }
  EXPECT_THAT(result.err, HasSubstr("the server has sent no scene"));
  EXPECT_FALSE(fs::exists(picture()));
}

TEST_F(Snapshot, SaysThatItIsNotTheRightPage) {
  gateway::Gateway::Options options;
  options.port = 0;
  options.page = folder_.path("no page");
  const gateway::Gateway gateway(own_session(), options);
  const ProgramResult result = take({"--url", gateway.url()});
  EXPECT_EQ(result.exit_code, 3);
  EXPECT_THAT(result.err, HasSubstr("the page was not built"));
}

TEST_F(Snapshot, SaysThatTheBrowserDied) {
  const auto gateway = gateway_without_scene();
  Process command(words({"--url", gateway->url(), "--browser", browser("exec " CHROMIUM " \"$@\""),
                         "--timeout", "200"}));
  const pid_t pid = browser_pid();
  ASSERT_GT(pid, 1);
  ::kill(pid, SIGKILL);
  EXPECT_EQ(command.wait(), 1);
  EXPECT_THAT(command.output(), HasSubstr("the browser ended before the picture was there"));
  EXPECT_FALSE(group_lives(pid));
}

TEST_F(Snapshot, EndsAllOfChromiumWhenInterrupted) {
  const auto gateway = gateway_without_scene();
  Process command(words({"--url", gateway->url(), "--browser", browser("exec " CHROMIUM " \"$@\""),
                         "--timeout", "200"}));
  const pid_t pid = browser_pid();
  ASSERT_GT(pid, 1);
  // It has made its profile: it is on the way.
  EXPECT_TRUE(eventually([&] {
    for (const auto& entry : fs::directory_iterator(temporary()))
      if (fs::exists(entry.path() / "Default")) return true;
    return false;
  }));
  command.send(SIGINT);
  EXPECT_EQ(command.wait(), 130);
  EXPECT_FALSE(group_lives(pid));
  EXPECT_FALSE(fs::exists(picture()));
}

TEST_F(SnapshotCommand, SaysWhatToInstallWhereThereIsNoBrowser) {
  const std::string path = std::getenv("PATH");
  ::setenv("PATH", folder_.path("empty").c_str(), 1);
  const ProgramResult result = take();
  ::setenv("PATH", path.c_str(), 1);
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, HasSubstr("no Chromium is installed"));
  EXPECT_THAT(result.err, HasSubstr("apt install chromium"));
}

TEST_F(SnapshotCommand, RepeatsTheLastWordOfABrowserThatEnds) {
  const ProgramResult result =
      take({"--browser", browser("echo 'no memory, no page' >&2; exit 3")});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, HasSubstr("no memory, no page"));
}

TEST_F(SnapshotCommand, WaitsNoLongerThanToldForABrowserThatIsSilent) {
  const ProgramResult result =
      take({"--browser", browser("sleep 1000 & wait"), "--timeout", "0.5"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, HasSubstr("no picture within the time given"));
  EXPECT_FALSE(group_lives(browser_pid()));
}

TEST_F(SnapshotCommand, RefusesABrowserThatSpeaksAnotherLanguage) {
  const ProgramResult result =
      take({"--browser", browser("printf 'hello\\0' >&4; sleep 1000 & wait")});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, HasSubstr("no DevTools message"));
  EXPECT_FALSE(group_lives(browser_pid()));
}

TEST_F(SnapshotCommand, SaysWhichFileCannotBeWrittenBeforeItStartsABrowser) {
  for (const std::string& file : {folder_.path("no/such/folder.png"), folder_.path("")}) {
    const ProgramResult result =
        testing::run_program({SUTURE_CLI, "snapshot", file, "--browser", browser("exit 9")});
    EXPECT_EQ(result.exit_code, 2) << file;
    EXPECT_THAT(result.err, HasSubstr(file + " cannot be written: "));
  }
  EXPECT_FALSE(fs::exists(folder_.path("pid")));
}

TEST_F(SnapshotCommand, RefusesArgumentsThatWillNotDo) {
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases{
      {{"--size", "640"}, "is no size"},        {{"--size", "0x400"}, "is no size"},
      {{"--size", "640x400px"}, "is no size"},  {{"--size", "9999x400"}, "is no size"},
      {{"--url", "127.0.0.1:8080"}, "address"}, {{"--url", "http://a/?view=x"}, "address"},
      {{"--theme", "pink"}, "--theme"},         {{"--browser", "/nowhere/chromium"}, "no program"},
  };
  for (const auto& [arguments, word] : cases) {
    const ProgramResult result = take(arguments);
    EXPECT_EQ(result.exit_code, 2) << arguments[1];
    EXPECT_THAT(result.err, HasSubstr(word)) << arguments[1];
  }
}

}  // namespace
}  // namespace sutured
