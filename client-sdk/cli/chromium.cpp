// SPDX-License-Identifier: Apache-2.0
#include "chromium.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string_view>
#include <system_error>
#include <vector>

#include "commands.hpp"
#include "suture/error.hpp"

extern "C" char** environ;

namespace suture::cli {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using namespace std::chrono_literals;

constexpr std::array kNames{"chromium",      "chromium-browser",      "google-chrome-stable",
                            "google-chrome", "chrome-headless-shell", "chromium-headless-shell"};
/// A picture of 4096 by 4096 pixels without any two alike, in base64.
constexpr std::size_t kMessageMax = 128U << 20U;
/// A signal that comes just before a wait is heeded that late.
constexpr auto kLook = 100ms;
/// A picture may wait; the forces of a server on this machine may not.
constexpr int kNice = 10;

bool is_program(const fs::path& path) {
  std::error_code ignored;
  return fs::is_regular_file(path, ignored) && ::access(path.c_str(), X_OK) == 0;
}

/// Returns the program of that name in PATH; empty where there is none.
std::string in_path(std::string_view name) {
  const char* const folders = std::getenv("PATH");  // NOLINT(concurrency-mt-unsafe)
  std::string_view left = folders == nullptr ? "" : folders;
  while (!left.empty()) {
    const std::size_t colon = std::min(left.find(':'), left.size());
    const fs::path path = fs::path(left.substr(0, colon)) / name;
    if (is_program(path)) return path.string();
    left.remove_prefix(std::min(colon + 1, left.size()));
  }
  return {};
}

/// Returns our environment with another TMPDIR.
std::vector<std::string> environment_with_temporary(const fs::path& folder) {
  std::vector<std::string> variables{"TMPDIR=" + folder.string()};
  for (char** variable = environ; *variable != nullptr; ++variable)
    if (!std::string_view(*variable).starts_with("TMPDIR=")) variables.emplace_back(*variable);
  return variables;
}

/// Returns pointers to `words` for a new process, which must not outlive them.
std::vector<char*> pointers_to(std::vector<std::string>& words) {
  std::vector<char*> pointers;
  for (std::string& word : words) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  return pointers;
}

/// Returns why Chromium gave up, as it wrote to its log: the fatal line, or else the last one.
std::string last_word(const fs::path& log) {
  std::ifstream file(log);
  std::string last;
  for (std::string line; std::getline(file, line);) {
    if (line.find(":FATAL:") != std::string::npos) return line;
    if (!line.empty()) last = line;
  }
  return last;
}

}  // namespace

std::string find_chromium(const std::string& asked) {
  if (!asked.empty()) {
    std::string program =
        asked.find('/') == std::string::npos ? in_path(asked) : (is_program(asked) ? asked : "");
    if (program.empty())
      throw Error(ErrorCode::kBadInput, "\"" + asked + "\" is no program",
                  "name a Chromium, as --browser /usr/bin/chromium, or leave --browser out");
    return program;
  }
  for (const char* name : kNames)
    if (std::string program = in_path(name); !program.empty()) return program;
  throw Error(ErrorCode::kNetwork,
              "no Chromium is installed here, and it is what draws the picture",
              "install it (Debian: `apt install chromium`), or name one by --browser");
}

Chromium::Chromium(const std::string& program, Clock::time_point deadline) : deadline_(deadline) {
  std::string folder = (fs::temp_directory_path() / "suture-snapshot-XXXXXX").string();
  if (::mkdtemp(folder.data()) == nullptr)
    throw Error(ErrorCode::kNetwork,
                "no folder can be made in " + fs::temp_directory_path().string() + ": " +
                    std::generic_category().message(errno),
                "let TMPDIR name a folder that is yours");
  folder_ = folder;
  try {
    start(program);
  } catch (...) {
    end();
    throw;
  }
}

Chromium::~Chromium() { end(); }

void Chromium::start(const std::string& program) {
  std::array<int, 2> ends{};
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0)
    throw Error(ErrorCode::kNetwork, "no socket: " + std::generic_category().message(errno), "");
  socket_ = ends[0];
  ::fcntl(socket_, F_SETFL, O_NONBLOCK);

  std::vector<std::string> words{
      program, "--headless", "--remote-debugging-pipe", "--user-data-dir=" + folder_.string(),
      "--no-first-run", "--no-default-browser-check", "--disable-background-networking",
      "--disable-component-update", "--disable-default-apps", "--disable-extensions",
      "--disable-sync", "--disable-breakpad", "--disable-crash-reporter",
      // Containers give /dev/shm 64 MB, less than a large picture needs.
      "--disable-dev-shm-usage", "--password-store=basic", "--hide-scrollbars",
      // The same picture on every machine, with a GPU or without.
      "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"};
  if (::geteuid() == 0) words.emplace_back("--no-sandbox");  // Chromium refuses it to root
  words.emplace_back("about:blank");
  // It leaves sockets and files in TMPDIR, too.
  std::vector<std::string> variables = environment_with_temporary(folder_);

  // Chromium reads 3 and writes 4: one socket is both.
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, ends[1], 3);
  posix_spawn_file_actions_adddup2(&actions, ends[1], 4);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, (folder_ / "stderr").c_str(),
                                   O_WRONLY | O_CREAT, 0600);
  posix_spawn_file_actions_adddup2(&actions, STDERR_FILENO, STDOUT_FILENO);
  // A group of its own: Ctrl-C is for us, who then end all of it.
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
  posix_spawnattr_setpgroup(&attributes, 0);
  // What its processes leave behind when they end comes to us, so that we know when all have.
  ::prctl(PR_SET_CHILD_SUBREAPER, 1);
  const int fault = ::posix_spawn(&pid_, program.c_str(), &actions, &attributes,
                                  pointers_to(words).data(), pointers_to(variables).data());
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  ::close(ends[1]);
  if (fault != 0) {
    pid_ = -1;
    throw Error(ErrorCode::kNetwork,
                program + " does not start: " + std::generic_category().message(fault),
                "name another Chromium by --browser");
  }
  ::setpriority(PRIO_PGRP, static_cast<id_t>(pid_), kNice);
}

void Chromium::end() noexcept {
  if (socket_ >= 0) ::close(socket_);
  socket_ = -1;
  if (pid_ > 0) {
    ::kill(-pid_, SIGKILL);  // nothing of it is kept: its profile is for this one picture
    while (::waitpid(-pid_, nullptr, 0) > 0 || errno == EINTR) {
    }
  }
  pid_ = -1;
  std::error_code ignored;
  fs::remove_all(folder_, ignored);
}

void Chromium::open_page() {
  const Json target = call("Target.createTarget", {{"url", "about:blank"}});
  const Json attached =
      call("Target.attachToTarget", {{"targetId", target.at("targetId")}, {"flatten", true}});
  page_ = attached.at("sessionId").get<std::string>();
  call("Page.enable", Json::object());
}

Json Chromium::call(const std::string& method, const Json& parameters) {
  events_.clear();
  Json message{{"id", ++calls_}, {"method", method}, {"params", parameters}};
  if (!page_.empty()) message["sessionId"] = page_;
  send(message.dump());
  for (;;) {
    Json answer = receive();
    if (answer.value("id", std::int64_t{0}) != calls_) continue;
    if (answer.contains("error"))
      throw Error(ErrorCode::kNetwork,
                  "the browser refuses " + method + ": " +
                      answer.at("error").value("message", std::string("it does not say why")),
                  "try another Chromium by --browser");
    return std::move(answer.at("result"));
  }
}

void Chromium::await_event(const std::string& method) {
  while (events_.find(method + "\n") == std::string::npos) receive();
}

void Chromium::send(const std::string& message) {
  std::string_view left(message.c_str(), message.size() + 1);  // its end is a zero byte
  while (!left.empty()) {
    const ssize_t sent = ::send(socket_, left.data(), left.size(), MSG_NOSIGNAL);
    if (sent >= 0) {
      left.remove_prefix(static_cast<std::size_t>(sent));
    } else if (errno == EAGAIN) {
      wait_for(POLLOUT);
    } else if (errno != EINTR) {
      throw_ended();
    }
  }
}

Json Chromium::receive() {
  for (;;) {
    const std::size_t end = received_.find('\0', searched_);
    if (end != std::string::npos) {
      Json message = Json::parse(received_.substr(0, end), nullptr, false);
      received_.erase(0, end + 1);
      searched_ = 0;
      if (!message.is_object())
        throw Error(ErrorCode::kNetwork, "the browser says what is no DevTools message",
                    "name a Chromium by --browser");
      const std::string event = message.value("method", std::string());
      if (event == "Inspector.targetCrashed")
        throw Error(ErrorCode::kNetwork, "the page crashed in the browser",
                    "try a smaller --size: it may have run out of memory");
      if (!event.empty() && message.value("sessionId", std::string()) == page_)
        events_ += event + "\n";
      return message;
    }
    searched_ = received_.size();
    if (received_.size() > kMessageMax)
      throw Error(ErrorCode::kNetwork, "the browser sends more than a picture can be",
                  "try a smaller --size");
    std::array<char, 65536> part{};
    const ssize_t got = ::recv(socket_, part.data(), part.size(), 0);
    if (got > 0) {
      received_.append(part.data(), static_cast<std::size_t>(got));
    } else if (got < 0 && errno == EAGAIN) {
      wait_for(POLLIN);
    } else if (got == 0 || errno != EINTR) {
      throw_ended();
    }
  }
}

void Chromium::wait_for(short readiness) {
  for (;;) {
    if (interrupted) throw Interrupted{};
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline_ - Clock::now());
    if (left <= 0ms) throw TimedOut{};
    pollfd on{socket_, readiness, 0};
    const int ready = ::poll(&on, 1, static_cast<int>(std::min(left, kLook + 0ms).count()));
    if (ready > 0 || (ready < 0 && errno != EINTR)) return;
  }
}

void Chromium::throw_ended() {
  const std::string said = last_word(folder_ / "stderr");
  throw Error(ErrorCode::kNetwork,
              "the browser ended before the picture was there" +
                  (said.empty() ? std::string() : ": " + said),
              "see whether it runs at all: `chromium --headless --dump-dom about:blank`");
}

}  // namespace suture::cli
