// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <csignal>
#include <cstdio>
#include <memory>

#include "commands.hpp"
#include "protocol/rendezvous.hpp"
#include "protocol/serialized.hpp"
#include "recording.hpp"
#include "sample_facts.hpp"

namespace suture::cli {
namespace {

// How many samples an instance wait for the taker: seconds, of poses as of frames.
constexpr int kControlDepth = 8192;
constexpr int kMeshDepth = 512;
constexpr std::int64_t kSecond_ns = 1'000'000'000;

std::vector<const TopicSpec*> choose_topics(const std::vector<std::string>& names) {
  std::vector<const TopicSpec*> chosen;
  for (const TopicSpec& topic : all_topics()) {
    if (names.empty()) chosen.push_back(&topic);
  }
  for (const std::string& name : names) {
    const TopicSpec* found = nullptr;
    std::string known;
    for (const TopicSpec& topic : all_topics()) {
      known += (known.empty() ? "" : ", ") + std::string(topic.name);
      if (name == topic.name || "suture/" + name == topic.name) found = &topic;
    }
    if (found == nullptr) {
      throw Error(ErrorCode::kBadInput, "there is no topic \"" + name + "\"", "take from " + known);
    }
    if (std::find(chosen.begin(), chosen.end(), found) == chosen.end()) chosen.push_back(found);
  }
  return chosen;
}

/// Follows which server answers, and in which epoch.
class ServerWatch {
 public:
  explicit ServerWatch(const SessionArguments& session) : session_(session) {}

  /// Takes a status, or the news that its writer has gone. Returns the metadata of a server or
  /// epoch not seen before, and says so.
  std::optional<mcap::Metadata> heed(std::span<const std::byte> status, const SampleInfo& info) {
    if (!info.valid) {
      if (!info.writers_alive) lost();
      return std::nullopt;
    }
    const std::optional<ServerFacts> facts = server_facts(status);
    if (!facts) return std::nullopt;
    if (facts->leaving) {
      lost();
      return std::nullopt;
    }
    const bool back = !present_;
    present_ = true;
    if (facts->epoch == epoch_) {
      if (back) say("the server answers again");
      return std::nullopt;
    }
    const bool same = epoch_ != 0 && facts->pid == pid_ && facts->started_ns == started_ns_;
    epoch_ = facts->epoch;
    pid_ = facts->pid;
    started_ns_ = facts->started_ns;
    say(same ? "the server was reset"
             : "server: sutured " + facts->version + " on " + facts->host + ", pid " +
                   std::to_string(facts->pid) + ", scene " + facts->scene);
    return mcap::Metadata{"suture.session",
                          {{"domain", std::to_string(session_.domain)},
                           {"session", facts->session},
                           {"scene", facts->scene},
                           {"epoch", std::to_string(facts->epoch)},
                           {"rate_hz", std::to_string(facts->rate_hz)},
                           {"host", facts->host},
                           {"pid", std::to_string(facts->pid)},
                           {"started_ns", std::to_string(facts->started_ns)},
                           {"server_version", facts->version}}};
  }
  void say_if_nobody_answers() {
    if (present_ || said_) return;
    said_ = true;
    say("no server answers yet in domain " + std::to_string(session_.domain) + ", " +
        session_text(session_.session) + ": waiting; Ctrl-C ends");
  }

 private:
  void lost() {
    if (present_) say("the server has left: waiting for one; Ctrl-C ends");
    present_ = false;
    said_ = true;
  }
  static void say(const std::string& text) {
    std::printf("%s%s\n", on_terminal() ? "\r\033[K" : "", text.c_str());
    std::fflush(stdout);
  }

  const SessionArguments& session_;
  std::uint64_t epoch_ = 0;
  std::int32_t pid_ = 0;
  std::int64_t started_ns_ = 0;
  bool present_ = false, said_ = false;
};

void print_summary(const Recording& recording, std::span<const TopicSpec* const> topics,
                   double duration_s, const std::string& file) {
  const Recording::Counts total = recording.total();
  std::printf("recorded %.1f s, %llu samples, %.1f MB: %s\n", duration_s,
              static_cast<unsigned long long>(total.samples - total.dropped),
              1e-6 * static_cast<double>(recording.size_bytes()), file.c_str());
  for (std::size_t i = 0; i < topics.size(); ++i) {
    const Recording::Counts& counts = recording.counts(i);
    if (counts.samples == 0) continue;
    std::printf("  %-22s %9llu", topics[i]->name, static_cast<unsigned long long>(counts.samples));
    if (counts.missing > 0) {
      std::printf("   %llu missing", static_cast<unsigned long long>(counts.missing));
    }
    if (counts.dropped > 0) {
      std::printf("   %llu dropped", static_cast<unsigned long long>(counts.dropped));
    }
    std::printf("\n");
  }
  if (total.missing > 0) {
    std::printf("%llu samples are missing: they were lost on the way here\n",
                static_cast<unsigned long long>(total.missing));
  }
  if (total.dropped > 0) {
    std::printf("%llu samples were dropped: the disk was too slow\n",
                static_cast<unsigned long long>(total.dropped));
  }
  if (total.missing + total.dropped == 0) std::printf("nothing was lost\n");
}

}  // namespace

int run_record(const RecordArguments& arguments) {
  const std::vector<const TopicSpec*> topics = choose_topics(arguments.topics);
  // A limit on the size of files is an error of `write`, like a full disk, not the end.
  std::signal(SIGXFSZ, SIG_IGN);
  ParticipantOptions options;
  options.domain = arguments.session.domain;
  options.session = arguments.session.session;
  options.security = arguments.session.security;
  options.network = arguments.session.network;
  const Participant control(options, Channel::kControl);
  const Participant mesh(options, Channel::kMesh);
  Recording recording(
      arguments.file,
      arguments.force ? mcap::Writer::Existing::kReplace : mcap::Writer::Existing::kRefuse, topics);

  WaitSet waitset;
  SerializedReader status(control, topic<v1::ServerStatus>(), {}, kControlDepth);
  waitset.attach(status);
  std::vector<std::unique_ptr<SerializedReader>> readers;
  for (const TopicSpec* topic : topics) {
    const bool control_topic = topic->channel == Channel::kControl;
    readers.push_back(std::make_unique<SerializedReader>(
        control_topic ? control : mesh, *topic, EndpointCallbacks{},
        control_topic ? kControlDepth : kMeshDepth));
    waitset.attach(*readers.back());
  }

  ServerWatch server(arguments.session);
  const std::int64_t begin_ns = monotonic_ns();
  std::int64_t told_ns = begin_ns;
  const auto over = [&] {
    return interrupted || recording.failed() ||
           (arguments.duration_s > 0.0 && recording.duration_s() >= arguments.duration_s);
  };
  while (!over()) {
    waitset.wait(std::chrono::milliseconds(50));
    status.take_each([&](const SerializedSample& sample, const SampleInfo& info) {
      if (std::optional<mcap::Metadata> news = server.heed(sample.bytes(), info)) {
        recording.add(std::move(*news));
      }
    });
    for (std::size_t i = 0; i < readers.size(); ++i) {
      readers[i]->take_each([&](SerializedSample sample, const SampleInfo& info) {
        if (info.valid) recording.add(i, std::move(sample), info);
      });
    }
    if (const std::int64_t now_ns = monotonic_ns(); now_ns - told_ns >= kSecond_ns) {
      told_ns = now_ns;
      server.say_if_nobody_answers();
      if (on_terminal()) {
        std::printf("\r\033[K%.0f s, %.1f MB", recording.duration_s(),
                    1e-6 * static_cast<double>(recording.size_bytes()));
        std::fflush(stdout);
      }
    }
  }
  if (on_terminal()) std::printf("\r\033[K");
  const double duration_s = recording.duration_s();
  try {
    if (!recording.finish()) {
      std::printf("nothing came: %s is as it was\n", arguments.file.c_str());
      return kDone;
    }
  } catch (const Error&) {
    print_summary(recording, topics, duration_s, arguments.file);
    throw;
  }
  print_summary(recording, topics, duration_s, arguments.file);
  return kDone;
}

}  // namespace suture::cli
