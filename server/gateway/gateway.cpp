// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/gateway.hpp"

#include <pthread.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <future>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include "gateway/access.hpp"
#include "gateway/client.hpp"
#include "gateway/feed.hpp"
#include "gateway/hands.hpp"
#include "gateway/metrics.hpp"
#include "gateway/scene_composer.hpp"
#include "gateway/site.hpp"
#include "gateway/web_server.hpp"

namespace sutured::gateway {
namespace {

constexpr std::size_t kClientsMax = 64;
constexpr std::chrono::milliseconds kScenePeriod(50);
constexpr std::chrono::milliseconds kHousekeeping(500);
constexpr std::int64_t kStatusStale_ns = 3'000'000'000;

// Lets the server's other threads go first on a processor that they share. The threads that this
// one starts inherit it: on Linux a nice value is a thread's own.
void go_behind_other_threads() noexcept {
  setpriority(PRIO_PROCESS, static_cast<id_t>(syscall(SYS_gettid)), 10);
}

suture::ParticipantOptions separate(suture::ParticipantOptions options) {
  options.separate = true;
  options.tool = "*";  // the tokens say who may drive what
  return options;
}

}  // namespace

class Gateway::State : public ChannelSource {
 public:
  State(const suture::ParticipantOptions& session, Options options)
      : options_(std::move(options)),
        access_(
            {options_.address, options_.tokens, options_.origins, !options_.certificate.empty()}),
        site_(options_.page),
        web_({.address = options_.address,
              .port = options_.port,
              .certificate = options_.certificate,
              .key = options_.key},
             {.get = [this](const Request& request) { return get(request); },
              .open = [this](const Request& request) { return open(request); },
              .fault = [this](const std::string& text) { options_.log(true, text); }}),
        control_(separate(session), suture::Channel::kControl),
        mesh_(separate(session), suture::Channel::kMesh),
        status_(control_),
        ports_(control_),
        scene_(mesh_),
        feed_(control_, mesh_, [this] { web_.post([this] { drain(); }); }),
        session_id_(std::to_string(suture::wall_clock_ns())) {
    channels_.assign(feed_.channels().begin(), feed_.channels().end());
    scene_channel_ = static_cast<std::uint32_t>(channels_.size() + 1);
    channels_.push_back(SceneComposer::channel(scene_channel_));
    for (const Channel& channel : feed_.channels())
      if (channel.topic == suture::topic<suture::v1::MeshFrame>().name) frame_channel_ = channel.id;
    web_.every(kScenePeriod, [this] { compose(); });
    web_.every(kHousekeeping, [this] { keep_house(); });
    thread_ = std::thread([this] {
      pthread_setname_np(pthread_self(), "gateway");
      web_.run();
    });
  }
  ~State() override {
    web_.stop();
    thread_.join();
  }
  State(const State&) = delete;
  State& operator=(const State&) = delete;

  [[nodiscard]] int viewers_beyond_readers() const noexcept { return viewers_beyond_readers_; }

  [[nodiscard]] std::string url() const {
    const bool v6 = options_.address.find(':') != std::string::npos;
    return (options_.certificate.empty() ? "http://" : "https://") +
           (v6 ? "[" + options_.address + "]" : options_.address) + ":" +
           std::to_string(web_.port()) + "/";
  }

  // ---------------------------------------------------------------- ChannelSource

  [[nodiscard]] std::span<const Channel> channels() const override { return channels_; }

  void subscribe(std::uint32_t channel) override {
    if (channel != scene_channel_) return feed_.subscribe(channel);
    if (scene_watchers_++ == 0) scene_.watch(true);
  }

  void unsubscribe(std::uint32_t channel) override {
    if (channel != scene_channel_) return feed_.unsubscribe(channel);
    if (--scene_watchers_ == 0) {
      scene_.watch(false);
      last_scene_.reset();
    }
  }

  void retained(std::uint32_t channel,
                const std::function<void(const Delivery&)>& use) const override {
    if (channel != scene_channel_) return feed_.retained(channel, use);
    if (last_scene_) use(*last_scene_);
  }

 private:
  // ---------------------------------------------------------------- HTTP

  Reply get(const Request& request) {
    if (auto refusal = access_.refuse(request)) return *refusal;
    if (request.path == "/healthz") return health();
    if (request.path == "/metrics") {
      if (!access_.grant(request)) return plain_reply(401, "a token is needed");
      return metrics();
    }
    return site_.get(request);
  }

  std::variant<Reply, WebServer::Accepted> open(const Request& request) {
    if (auto refusal = access_.refuse(request)) return *refusal;
    auto grant = access_.grant(request);
    if (!grant) return plain_reply(401, "a token is needed, and this is none that holds");
    const auto subprotocol = choose_subprotocol(request.subprotocols);
    if (!subprotocol)
      return plain_reply(400, "the subprotocol must be foxglove.sdk.v1 or foxglove.websocket.v1");
    if (clients_.size() >= kClientsMax)
      return plain_reply(503, "no more than " + std::to_string(kClientsMax) + " clients at once");
    // The WebSocket owns its client; the set here is of those that live.
    auto* const client = new Client(*this, ports_, std::move(*grant), session_id_);
    clients_.insert(client);
    std::shared_ptr<WebClient> owned(client, [this](WebClient* gone) {
      auto* const left = static_cast<Client*>(gone);
      clients_.erase(left);
      dropped_before_ += left->outbox().dropped();
      delete left;
    });
    return WebServer::Accepted{std::move(owned), std::string(*subprotocol)};
  }

  Reply health() {
    std::string fault = "no status has come from the server";
    with_status([&](const suture::v1::ServerStatus& status) {
      fault.clear();
      if (suture::wall_clock_ns() - status.stamp_ns > kStatusStale_ns)
        fault = "the last status is " +
                std::to_string((suture::wall_clock_ns() - status.stamp_ns) / 1'000'000'000) +
                " s old";
      else if (status.state == suture_v1_SERVER_LEAVING)
        fault = "the server leaves";
      else if (status.state_reason[0] != '\0')
        fault = suture::text_of(status.state_reason);
    });
    return fault.empty() ? plain_reply(200, "ok") : plain_reply(503, fault);
  }

  Reply metrics() {
    ClientCounters counters;
    counters.clients = clients_.size();
    counters.dropped = dropped_before_;
    for (const Client* client : clients_) {
      counters.dropped += client->outbox().dropped();
      counters.waiting_bytes += client->outbox().bytes();
    }
    std::optional<std::string> text;
    with_status([&](const suture::v1::ServerStatus& status) {
      text = metrics_text(&status, web_.counters(), counters);
    });
    if (!text) text = metrics_text(nullptr, web_.counters(), counters);
    Reply reply;
    reply.content_type = "text/plain; version=0.0.4; charset=utf-8";
    reply.body = std::make_shared<const std::string>(std::move(*text));
    return reply;
  }

  template <class Use>
  void with_status(Use&& use) {
    status_.read_latest(
        [&](const suture::v1::ServerStatus& status, const suture::SampleInfo&) { use(status); });
  }

  // ---------------------------------------------------------------- samples

  void deliver(const Delivery& delivery) {
    for (Client* client : clients_) client->deliver(delivery);
  }

  void drain() {
    feed_.drain([this](const Delivery& delivery) { deliver(delivery); });
  }

  void compose() {
    auto sample = scene_.compose();
    if (!sample) return;
    last_scene_ = Delivery{scene_channel_, 0, 1, suture::wall_clock_ns(), std::move(*sample)};
    deliver(*last_scene_);
  }

  // Our readers of frames stand for the clients who watch.
  void count_viewers() {
    int watchers = 0;
    for (const Client* client : clients_)
      if (client->listens_to(frame_channel_) || client->listens_to(scene_channel_)) ++watchers;
    const int readers = (feed_.reads(frame_channel_) ? 1 : 0) + (scene_.reads() ? 1 : 0);
    viewers_beyond_readers_ = watchers - readers;
  }

  void keep_house() {
    if (const std::string word = access_.reload(); !word.empty()) options_.log(true, word);
    for (Client* client : clients_) client->renew(access_);
    const auto now = std::chrono::steady_clock::now();
    feed_.close_idle(now);
    scene_.close_idle(now);
    count_viewers();
  }

  Options options_;
  Access access_;
  Site site_;
  std::set<Client*> clients_;
  std::uint64_t dropped_before_ = 0;  // by clients that have left
  WebServer web_;                     // its end ends the clients, who refer to all this
  suture::Participant control_, mesh_;
  suture::Reader<suture::v1::ServerStatus> status_;
  HandPorts ports_;
  SceneComposer scene_;
  Feed feed_;
  std::string session_id_;
  std::vector<Channel> channels_;
  std::uint32_t scene_channel_ = 0, frame_channel_ = 0;
  std::atomic<int> viewers_beyond_readers_ = 0;
  int scene_watchers_ = 0;
  std::optional<Delivery> last_scene_;
  std::thread thread_;
};

Gateway::Gateway(const suture::ParticipantOptions& session, Options options)
    : state_(std::async(std::launch::async, [&] {
               go_behind_other_threads();
               return std::make_unique<State>(session, std::move(options));
             }).get()) {}

Gateway::~Gateway() = default;

std::string Gateway::url() const { return state_->url(); }

int Gateway::viewers_beyond_readers() const noexcept { return state_->viewers_beyond_readers(); }

}  // namespace sutured::gateway
