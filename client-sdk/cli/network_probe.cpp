// SPDX-License-Identifier: Apache-2.0
#include "network_probe.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <semaphore>
#include <string>
#include <system_error>
#include <thread>

#include "protocol/endpoint.hpp"

namespace suture::cli {
namespace {

constexpr std::size_t kPacket = 128;  // as a pose or a force on the wire
constexpr const char* kTool = "doctor";

ParticipantOptions session_of(std::uint32_t domain, pid_t owner) {
  ParticipantOptions options;
  options.domain = domain;
  options.session = "doctor-" + std::to_string(owner);
  options.security = "off";
  return options;
}

[[noreturn]] void fail(const char* what) {
  throw Error(ErrorCode::kNetwork,
              std::string(what) + ": " + std::error_code(errno, std::generic_category()).message(),
              "");
}

int loopback_socket(std::uint16_t& port) {
  const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (fd < 0) fail("no UDP socket");
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  if (bind(fd, reinterpret_cast<sockaddr*>(&address), size) != 0 ||
      getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    fail("no UDP port");
  }
  port = ntohs(address.sin_port);
  return fd;
}

/// The child: echoes until the lifeline closes.
void echo_until_closed(std::uint32_t domain, pid_t owner, int udp, int lifeline) {
  const Participant participant(session_of(domain, owner), Channel::kControl);
  Writer<v1::ToolForce> writer(participant);
  std::atomic<Reader<v1::ToolPose>*> ready{nullptr};
  EndpointCallbacks callbacks;
  callbacks.data_available = [&] {
    Reader<v1::ToolPose>* const reader = ready;
    if (reader == nullptr) return;
    v1::ToolPose pose;
    SampleInfo info;
    while (reader->take(pose, info)) {
      if (!info.valid) continue;
      v1::ToolForce force{};
      force.tool_id = pose.tool_id;
      force.pose_sequence = pose.sequence_number;
      writer.write(force);
    }
  };
  Reader<v1::ToolPose> reader(participant, std::move(callbacks));
  ready = &reader;
  for (;;) {
    pollfd waiting[2] = {{udp, POLLIN, 0}, {lifeline, POLLIN, 0}};
    if (poll(waiting, 2, -1) < 0 && errno != EINTR) return;
    if (waiting[1].revents != 0) return;
    if ((waiting[0].revents & POLLIN) == 0) continue;
    char packet[kPacket];
    sockaddr_in from{};
    socklen_t size = sizeof from;
    const ssize_t got =
        recvfrom(udp, packet, sizeof packet, 0, reinterpret_cast<sockaddr*>(&from), &size);
    if (got > 0) {
      sendto(udp, packet, static_cast<std::size_t>(got), 0, reinterpret_cast<sockaddr*>(&from),
             size);
    }
  }
}

/// One UDP echo; negative where none came back.
std::int64_t udp_round_trip(int fd) {
  char packet[kPacket] = {};
  const std::int64_t sent_ns = monotonic_ns();
  if (send(fd, packet, sizeof packet, 0) < 0) return -1;
  pollfd waiting{fd, POLLIN, 0};
  if (poll(&waiting, 1, 20) <= 0 || recv(fd, packet, sizeof packet, 0) < 0) return -1;
  return monotonic_ns() - sent_ns;
}

}  // namespace

EchoPeer::EchoPeer(std::uint32_t domain) : domain_(domain), owner_(getpid()) {
  int lifeline[2];
  if (pipe(lifeline) != 0) fail("no pipe");
  const int udp = loopback_socket(port_);
  child_ = fork();
  if (child_ < 0) fail("no second process");
  if (child_ == 0) {
    ::close(lifeline[1]);
    int code = 0;
    try {
      echo_until_closed(domain_, owner_, udp, lifeline[0]);
    } catch (const Error&) {
      code = 1;  // the parent reports that nobody answers
    }
    _exit(code);
  }
  ::close(udp);
  ::close(lifeline[0]);
  lifeline_ = lifeline[1];
}

EchoPeer::~EchoPeer() {
  ::close(lifeline_);
  waitpid(child_, nullptr, 0);
}

void EchoPeer::measure(double seconds, RoundTrips& result) {
  std::uint16_t own_port = 0;
  const int udp = loopback_socket(own_port);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(port_);
  if (connect(udp, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0) {
    ::close(udp);
    fail("no UDP connection");
  }

  const Participant participant(session_of(domain_, owner_), Channel::kControl);
  std::atomic<std::int64_t> arrived_ns{0};
  std::atomic<std::uint64_t> awaited{0};
  std::binary_semaphore answered{0};
  std::atomic<Reader<v1::ToolForce>*> ready{nullptr};
  EndpointCallbacks callbacks;
  callbacks.data_available = [&] {
    Reader<v1::ToolForce>* const reader = ready;
    if (reader == nullptr) return;
    v1::ToolForce force;
    SampleInfo info;
    while (reader->take(force, info)) {
      // Each sequence is awaited once, so that the semaphore never counts beyond one.
      std::uint64_t expected = force.pose_sequence;
      if (!info.valid || !awaited.compare_exchange_strong(expected, 0)) continue;
      arrived_ns = monotonic_ns();
      answered.release();
    }
  };
  Writer<v1::ToolPose> writer(participant);
  Reader<v1::ToolForce> reader(participant, std::move(callbacks));
  ready = &reader;

  using Clock = std::chrono::steady_clock;
  const Clock::time_point patience = Clock::now() + std::chrono::seconds(5);
  while ((writer.matched() == 0 || reader.matched() == 0) && Clock::now() < patience) {
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  result.met = writer.matched() > 0 && reader.matched() > 0;

  v1::ToolPose pose{};
  pose.tool_id = tool_id(kTool);
  pose.orientation_xyzw[3] = 1.0;
  const int rounds = static_cast<int>(seconds * 1000.0);
  Clock::time_point next = Clock::now();
  for (int i = 0; i < rounds; ++i) {
    next += std::chrono::milliseconds(1);
    std::this_thread::sleep_until(next);
    const std::int64_t udp_ns = udp_round_trip(udp);
    if (udp_ns >= 0) result.udp.record(udp_ns);
    if (!result.met) continue;
    awaited = ++pose.sequence_number;
    const std::int64_t sent_ns = monotonic_ns();
    writer.write(pose);
    if (answered.try_acquire_for(std::chrono::milliseconds(20))) {
      result.dds.record(arrived_ns - sent_ns);
    } else if (std::uint64_t expected = pose.sequence_number;
               awaited.compare_exchange_strong(expected, 0)) {
      ++result.dds_lost;
    } else {
      answered.acquire();  // it came at the last moment
      result.dds.record(arrived_ns - sent_ns);
    }
  }
  ::close(udp);
}

}  // namespace suture::cli
