// SPDX-License-Identifier: Apache-2.0
#include <time.h>

#include <cerrno>
#include <cstdio>
#include <map>
#include <memory>

#include "commands.hpp"
#include "mcap/reader.hpp"
#include "protocol/rendezvous.hpp"
#include "protocol/serialized.hpp"
#include "protocol/whole_file.hpp"
#include "recorded_surgeon.hpp"

namespace suture::cli {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;

void say_damage(const mcap::Reader& reader) {
  if (reader.damage().empty()) return;
  std::fflush(stdout);
  std::fprintf(stderr, "suture: %s\n  what stands before it was read\n", reader.damage().c_str());
}

/// Waits until `due_ns` on the monotonic clock; false where a signal wants an end.
bool wait_until(std::int64_t due_ns) {
  const timespec due{due_ns / kSecond_ns, due_ns % kSecond_ns};
  while (!interrupted && clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, nullptr) != 0) {
  }
  return !interrupted;
}

/// The writers of a session, one a topic.
class Publishers {
 public:
  explicit Publishers(const SessionArguments& arguments)
      : control_(options(arguments), Channel::kControl), mesh_(options(arguments), Channel::kMesh) {
    for (const TopicSpec& topic : all_topics()) {
      const bool control = topic.channel == Channel::kControl;
      writers_[topic.name] = {
          &topic, std::make_unique<SerializedWriter>(control ? control_ : mesh_, topic)};
    }
    // Readers find the writers meanwhile.
    const std::optional<ServerInfo> server = find_other_server(control_, std::chrono::seconds(1));
    if (server) {
      throw Error(ErrorCode::kServerRunning,
                  "a server answers in this session (sutured " + server->version + " on " +
                      server->host + ", scene " + server->scene +
                      "): what it sends and the recording would mix",
                  "play in another session, --session NAME, and look there");
    }
  }

  /// Publishes a message of that topic and type; false where it is not one of ours.
  bool publish(const std::string& topic, const std::string& type,
               std::span<const std::byte> bytes) {
    const auto found = writers_.find(topic);
    return found != writers_.end() && type == found->second.topic->descriptor->m_typename &&
           found->second.writer->write(bytes);
  }
  /// Waits, a second a topic at most, until readers have what they must not miss.
  void await_acknowledgements() {
    for (const auto& [name, place] : writers_) {
      if (place.topic->reliable) dds_wait_for_acks(place.writer->handle(), DDS_SECS(1));
    }
  }

 private:
  static ParticipantOptions options(const SessionArguments& arguments) {
    ParticipantOptions options;
    options.domain = arguments.domain;
    options.session = arguments.session;
    options.security = arguments.security;
    options.network = arguments.network;
    options.tool = "*";  // poses of whoever drove then
    return options;
  }
  struct Place {
    const TopicSpec* topic = nullptr;
    std::unique_ptr<SerializedWriter> writer;
  };
  Participant control_, mesh_;
  std::map<std::string, Place> writers_;
};

struct Played {
  std::uint64_t messages = 0;
  std::uint64_t refused = 0;
  std::int64_t duration_ns = 0;
};

Played play_once(mcap::Reader& reader, Publishers& session, double rate) {
  Played played;
  const std::int64_t begin_ns = monotonic_ns();
  std::optional<std::uint64_t> first_ns;
  mcap::Message message;
  while (!interrupted && reader.next(message)) {
    if (!first_ns) first_ns = message.log_time_ns;
    const auto since_ns = static_cast<std::int64_t>(message.log_time_ns - *first_ns);
    played.duration_ns = std::max(played.duration_ns, since_ns);
    if (!wait_until(begin_ns + static_cast<std::int64_t>(static_cast<double>(since_ns) / rate))) {
      break;
    }
    const mcap::Channel& channel = reader.channel(message);
    const mcap::Schema* schema = reader.schema(channel);
    const bool sent = channel.encoding == "cdr" && schema != nullptr &&
                      session.publish(channel.topic, schema->name, message.data);
    ++(sent ? played.messages : played.refused);
  }
  return played;
}

int play(const ReplayArguments& arguments) {
  mcap::Reader first(arguments.file);  // before anything else: it may be no recording
  Publishers session(arguments.session);
  std::printf("playing %s at %g times its speed; Ctrl-C ends\n", arguments.file.c_str(),
              arguments.rate);
  std::fflush(stdout);
  bool again = false;
  do {
    std::optional<mcap::Reader> anew;
    if (again) anew.emplace(arguments.file);
    mcap::Reader& reader = again ? *anew : first;
    const Played played = play_once(reader, session, arguments.rate);
    session.await_acknowledgements();
    std::printf("played %.1f s of it, %llu samples\n",
                1e-9 * static_cast<double>(played.duration_ns),
                static_cast<unsigned long long>(played.messages));
    if (played.refused > 0) {
      std::printf(
          "%llu samples were left out: not of a topic and type that this version knows, "
          "or no reader took them in time\n",
          static_cast<unsigned long long>(played.refused));
    }
    say_damage(reader);
    if (played.messages == 0 && !interrupted) {
      throw Error(ErrorCode::kBadInput, arguments.file + ": holds nothing to play",
                  "record a session with `suture record`");
    }
    again = true;
  } while (arguments.loop && !interrupted);
  return interrupted ? kInterrupted : kDone;
}

int write_surgeon(const ReplayArguments& arguments) {
  if (same_file(arguments.file, arguments.surgeon)) {
    throw Error(ErrorCode::kBadInput, arguments.surgeon + ": is the recording",
                "give --surgeon a file of its own");
  }
  mcap::Reader reader(arguments.file);
  const RecordedSurgeon recorded = surgeon_of(reader, arguments.epoch);
  say_damage(reader);
  std::FILE* file = std::fopen(arguments.surgeon.c_str(), arguments.force ? "w" : "wx");
  if (file == nullptr && errno == EEXIST) {
    throw Error(ErrorCode::kBadInput, arguments.surgeon + ": exists",
                "choose another name, or replace it with --force");
  }
  const std::string text = surgeon_text(recorded.surgeon);
  const bool written =
      file != nullptr && std::fwrite(text.data(), 1, text.size(), file) == text.size();
  if ((file != nullptr && std::fclose(file) != 0) || !written) {
    throw Error(
        ErrorCode::kBadInput,
        arguments.surgeon + ": cannot be written: " + std::generic_category().message(errno),
        "check the folder, its permissions and its room");
  }
  std::printf("%s: scene %s, epoch %llu, %g steps a second\n", arguments.surgeon.c_str(),
              recorded.scene.empty() ? "unknown" : recorded.scene.c_str(),
              static_cast<unsigned long long>(recorded.epoch), recorded.rate_hz);
  for (const SurgeonTrack& track : recorded.surgeon.tracks) {
    std::printf("  %-20s %zu rows, %.3f to %.3f s\n", track.tool.c_str(), track.rows.size(),
                track.begin_s(), track.end_s());
  }
  for (const std::string& note : recorded.notes) std::printf("note: %s\n", note.c_str());
  if (recorded.notes.empty()) std::printf("every step of the server is there, with its hands\n");
  return kDone;
}

}  // namespace

int run_replay(const ReplayArguments& arguments) {
  return arguments.surgeon.empty() ? play(arguments) : write_surgeon(arguments);
}

}  // namespace suture::cli
