// SPDX-License-Identifier: Apache-2.0
#include "protocol/participant.hpp"

#include <dds/dds.h>
#include <pthread.h>

#include <cstdlib>
#include <map>
#include <mutex>

namespace suture {
namespace {

// A separate participant's domain is another one within the process, and the same on the
// network. (With keys: `separate_secured_domain`.)
constexpr std::uint32_t kSeparate = 1000;

std::string domain_configuration(std::uint32_t network_domain, const Network& network,
                                 Channel channel, bool realtime) {
  std::string xml =
      "<CycloneDDS><Domain Id=\"any\">"
      "<Discovery><ExternalDomainId>" +
      std::to_string(network_domain) +
      "</ExternalDomainId></Discovery>"
      "<Internal><MultipleReceiveThreads>false</MultipleReceiveThreads>";
  if (channel == Channel::kMesh) xml += "<SocketReceiveBufferSize max=\"4MB\"/>";
  xml += "</Internal>";
  if (channel == Channel::kMesh) {
    xml +=
        "<General><MaxMessageSize>65500B</MaxMessageSize>"
        "<FragmentSize>65000B</FragmentSize></General>";
  }
  // Only forces are urgent: a burst of meshes must not run before anything else.
  if (channel == Channel::kControl && realtime) {
    xml += "<Threads><Thread Name=\"recv\"><Scheduling><Class>realtime</Class><Priority>" +
           std::to_string(kReceivePriority) + "</Priority></Scheduling></Thread></Threads>";
  }
  xml += "</Domain></CycloneDDS>," + network_configuration(network);
  // concurrency: read once at set-up; nothing in this library calls setenv.
  const char* user = std::getenv("CYCLONEDDS_URI");  // NOLINT(concurrency-mt-unsafe)
  if (user != nullptr && *user != '\0') xml = xml + "," + user;
  return xml +
         ",<CycloneDDS><Domain Id=\"any\"><SharedMemory><Enable>false</Enable></SharedMemory>"
         "</Domain></CycloneDDS>";
}

// The domains of this process. Cyclone keeps one configuration a domain and process,
// given by whoever creates it first.
struct Domains {
  std::mutex mutex;
  struct Use {
    dds_entity_t handle = 0;  // 0: made by other code of this process, not ours to delete
    int users = 0;
    bool realtime = false;
  };
  std::map<std::uint32_t, Use> uses;
};

Domains& domains() {
  static Domains instance;
  return instance;
}

bool open_domain(std::uint32_t id, std::uint32_t network_domain, const Network& network,
                 Channel channel) {
  Domains& all = domains();
  const std::lock_guard lock(all.mutex);
  Domains::Use& use = all.uses[id];
  if (use.users == 0 && use.handle == 0) {
    const bool realtime =
        id == network_domain && channel == Channel::kControl && may_run_realtime(kReceivePriority);
    const dds_entity_t handle = dds_create_domain(
        id, domain_configuration(network_domain, network, channel, realtime).c_str());
    if (handle < 0 && handle != DDS_RETCODE_PRECONDITION_NOT_MET) {
      all.uses.erase(id);
      throw Error(ErrorCode::kNetwork,
                  "DDS domain " + std::to_string(network_domain) +
                      " cannot be configured: " + dds_strretcode(handle),
                  "check that a network interface is up and that CYCLONEDDS_URI, if set, "
                  "is valid (its faults are printed above)");
    }
    use.handle = handle > 0 ? handle : 0;
    if (handle > 0) {  // else another's, who sees to it
      try {
        confine_sockets(network_domain, network);
      } catch (...) {
        dds_delete(handle);
        all.uses.erase(id);
        throw;
      }
    }
    use.realtime = handle > 0 && realtime;
  }
  ++use.users;
  return use.realtime;
}

void close_domain(std::uint32_t id) noexcept {
  Domains& all = domains();
  const std::lock_guard lock(all.mutex);
  const auto found = all.uses.find(id);
  if (found == all.uses.end() || --found->second.users > 0) return;
  // Deleting a domain deletes every participant in it, also those of other code.
  if (found->second.handle > 0) {
    if (dds_lookup_participant(id, nullptr, 0) > 0) return;
    dds_delete(found->second.handle);
  }
  all.uses.erase(found);
}

using QosPtr = std::unique_ptr<dds_qos_t, decltype(&dds_delete_qos)>;

void* do_nothing(void*) { return nullptr; }

[[noreturn]] void refuse_tool(const Identity& identity, const std::string& tool) {
  std::string own;
  for (const std::string& name : identity.tools) own += (own.empty() ? "" : ", ") + name;
  throw Error(ErrorCode::kPermissionDenied,
              "the keys of \"" + identity.name + "\" give no right to the tool \"" + tool + "\"" +
                  (own.empty() ? " nor to any other" : " (but to: " + own + ")"),
              "take its own tool, or have the site make keys with `suture keys add SITE NAME "
              "--role device --tool " +
                  tool + "`");
}

}  // namespace

bool may_run_realtime(int priority) noexcept {
  pthread_attr_t attributes;
  if (pthread_attr_init(&attributes) != 0) return false;
  sched_param parameters{};
  parameters.sched_priority = priority;
  pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
  pthread_attr_setschedpolicy(&attributes, SCHED_FIFO);
  pthread_attr_setschedparam(&attributes, &parameters);
  pthread_t thread{};
  const bool permitted = pthread_create(&thread, &attributes, do_nothing, nullptr) == 0;
  if (permitted) pthread_join(thread, nullptr);
  pthread_attr_destroy(&attributes);
  return permitted;
}

void throw_dds_error(dds_return_t code, const std::string& what) {
  const std::string cause = what + " failed: " + dds_strretcode(code);
  switch (code) {
    case DDS_RETCODE_NOT_ALLOWED_BY_SECURITY:
      throw Error(ErrorCode::kPermissionDenied, cause,
                  "these keys give no right to that: see `suture keys list` at the site, and the "
                  "roles in docs/guide/security.md");
    case DDS_RETCODE_OUT_OF_RESOURCES:
      throw Error(ErrorCode::kNetwork, cause, "too many participants or no memory left");
    default:
      throw Error(ErrorCode::kNetwork, cause,
                  "check that a network interface is up and its ports are free");
  }
}

struct Participant::State {
  ParticipantOptions options;
  std::optional<Identity> identity;
  Channel channel = Channel::kControl;
  std::uint32_t domain = 0;
  bool opened = false;
  bool realtime = false;
  dds_entity_t participant = 0;
  dds_entity_t publisher = 0;
  dds_entity_t subscriber = 0;

  ~State() {
    if (participant > 0) dds_delete(participant);
    if (opened) close_domain(domain);
  }
};

Participant::Participant(const ParticipantOptions& options, Channel channel)
    : state_(std::make_unique<State>()) {
  if (options.domain % 2 != 0 || options.domain > kMaxDomain) {
    throw Error(ErrorCode::kBadInput, "domain " + std::to_string(options.domain) + " is not usable",
                "take an even number from 0 to " + std::to_string(kMaxDomain) +
                    " (meshes travel in the next, odd one)");
  }
  if (options.session.size() > 64 || options.session.find_first_of("*?[],") != std::string::npos ||
      options.session.starts_with(kToolMark)) {
    throw Error(ErrorCode::kBadInput, "session name \"" + options.session + "\" is not usable",
                "take up to 64 characters without * ? [ ] or a comma, not beginning with @");
  }
  State& state = *state_;
  state.options = options;
  state.channel = channel;
  const std::uint32_t network_domain = options.domain + (channel == Channel::kMesh ? 1U : 0U);
  if (const std::string folder = security_folder(options.security); !folder.empty()) {
    state.identity = read_identity(folder);
    if (!options.tool.empty() && !state.identity->may_drive(options.tool))
      refuse_tool(*state.identity, options.tool);
  }
  if (state.identity && network_domain >= kSecuredDomains)
    throw Error(ErrorCode::kBadInput,
                "domain " + std::to_string(options.domain) + " cannot be used with keys",
                "take an even number from 0 to " + std::to_string(kSecuredDomains - 2));
  const Network network = find_network(options.network, state.identity.has_value());
  state.domain = !options.separate ? network_domain
                 : state.identity  ? separate_secured_domain(network_domain)
                                   : network_domain + kSeparate;
  state.realtime = open_domain(state.domain, network_domain, network, channel);
  state.opened = true;

  const QosPtr qos(dds_create_qos(), &dds_delete_qos);
  if (state.identity) {
    for (const auto& [name, value] : state.identity->properties)
      dds_qset_prop(qos.get(), name.c_str(), value.c_str());
  }
  state.participant = dds_create_participant(state.domain, qos.get(), nullptr);
  if (state.participant < 0) {
    throw_dds_error(state.participant, "joining DDS domain " + std::to_string(network_domain));
  }
  const QosPtr group(dds_create_qos(), &dds_delete_qos);
  const std::string claim = tool_partition(options.tool);
  const char* partitions[] = {options.every_session ? "*" : state.options.session.c_str(),
                              claim.c_str()};
  if (!options.every_session) {
    dds_qset_partition(group.get(), state.identity && !options.tool.empty() ? 2 : 1, partitions);
    state.publisher = dds_create_publisher(state.participant, group.get(), nullptr);
    if (state.publisher < 0) throw_dds_error(state.publisher, "making a DDS publisher");
  }
  dds_qset_partition(group.get(), 1, partitions);
  state.subscriber = dds_create_subscriber(state.participant, group.get(), nullptr);
  if (state.subscriber < 0) throw_dds_error(state.subscriber, "making a DDS subscriber");
}

Participant::~Participant() = default;
Participant::Participant(Participant&&) noexcept = default;
Participant& Participant::operator=(Participant&&) noexcept = default;

dds_entity_t Participant::handle() const noexcept { return state_->participant; }
dds_entity_t Participant::publisher() const noexcept { return state_->publisher; }
dds_entity_t Participant::subscriber() const noexcept { return state_->subscriber; }
Channel Participant::channel() const noexcept { return state_->channel; }
const std::optional<Identity>& Participant::identity() const noexcept { return state_->identity; }
const ParticipantOptions& Participant::options() const noexcept { return state_->options; }
bool Participant::receives_in_realtime() const noexcept { return state_->realtime; }

}  // namespace suture
