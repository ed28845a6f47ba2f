// SPDX-License-Identifier: Apache-2.0
// The subcommands of `suture`. Each returns an exit code, and throws suture::Error for
// what ends it early.
#pragma once

#include <atomic>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "suture/network.hpp"

namespace suture::cli {

/// Exit codes, the same for all subcommands; `--help` lists them.
enum ExitCode : int {
  kDone = 0,
  kFailed = 1,
  kUsage = 2,  ///< arguments or an input file
  kNoServer = 3,
  kVersion = 4,
  kTool = 5,  ///< unknown, or held by another device
  kPermission = 6,
  kInterrupted = 130,
};

/// Where the session is; options shared by all subcommands that need one.
struct SessionArguments {
  std::uint32_t domain = 0;
  std::string session;
  std::string security;  ///< folder of keys; empty: the environment's, or unsecured
  NetworkOptions network;
  double timeout_s = 3.0;
};

struct DeviceArguments {
  SessionArguments session;
  std::vector<std::string> tools;  ///< empty: all of the surgeon file
  std::string surgeon;
  std::string render = "server";
  std::string log;
  std::string plot;
  std::string summary;
  double rate_hz = 1000.0;
  double max_force_n = 0.0, max_slew_n_per_s = 0.0, max_stiffness_n_per_m = 0.0,
         max_damping_n_s_per_m = 0.0;  ///< 0: none
  bool loop = false;
  bool pause_at_end = false;
  bool quiet = false;
};

struct TopArguments {
  SessionArguments session;
  bool once = false;
};

struct SessionsArguments {
  std::vector<std::uint32_t> domains{0};
  bool all_domains = false;
  std::string security;
  NetworkOptions network;
  double timeout_s = 3.0;
  bool json = false;
};

struct DoctorArguments {
  std::uint32_t domain = 0;
  std::string security;  ///< folder of keys to look at
  double seconds = 2.0;
  bool network = true;
};

struct RecordArguments {
  SessionArguments session;  ///< without its timeout
  std::string file;
  std::vector<std::string> topics;  ///< empty: all
  double duration_s = 0.0;          ///< from the first sample on; 0: until interrupted
  bool force = false;
};

struct ReplayArguments {
  SessionArguments session;  ///< without its timeout
  std::string file;
  double rate = 1.0;
  bool loop = false;
  std::string surgeon;  ///< write this surgeon file instead of playing
  std::optional<std::uint64_t> epoch;
  bool force = false;
};

struct PictureSize {
  int width_px = 1600;
  int height_px = 1000;
};

struct SnapshotArguments {
  std::string file;
  std::string url = "http://127.0.0.1:8080/";
  std::string token;  ///< empty: that of the address, or none
  std::string view = "overview";
  std::string theme = "light";
  std::string browser;  ///< empty: the first Chromium that is installed
  PictureSize size;
  double timeout_s = 30.0;
};

struct CommandArguments {
  SessionArguments session;
  std::string kind;
  std::string value;  ///< checkpoint and restore: a name; rewind: seconds
  std::string tool;
};

struct KeysArguments {
  std::string site;
  std::string title = "sutured";
  std::string protection = "encrypt-origin";
  std::string name;
  std::vector<std::string> roles, tools;
  int domain = -1;  ///< all
  std::string session;
  int days = 0;
  bool revoke_old = false;
};

int run_keys_init(const KeysArguments& arguments);
int run_keys_add(const KeysArguments& arguments);
int run_keys_renew(const KeysArguments& arguments);
int run_keys_revoke(const KeysArguments& arguments);
int run_keys_list(const KeysArguments& arguments);
int run_device(const DeviceArguments& arguments);
int run_top(const TopArguments& arguments);
int run_sessions(const SessionsArguments& arguments);
int run_doctor(const DoctorArguments& arguments);
int run_record(const RecordArguments& arguments);
int run_replay(const ReplayArguments& arguments);
int run_snapshot(const SnapshotArguments& arguments);
int run_command(const CommandArguments& arguments);

/// Set by SIGINT and SIGTERM.
extern std::atomic<bool> interrupted;

/// Says whether standard output is a terminal.
[[nodiscard]] bool on_terminal() noexcept;

}  // namespace suture::cli
