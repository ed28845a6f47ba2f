// SPDX-License-Identifier: Apache-2.0
// Typed readers and writers over the C API of Cyclone DDS.
#pragma once

#include <dds/dds.h>

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "protocol/participant.hpp"
#include "protocol/topics.hpp"

namespace suture {

/// What callers may want to hear of an endpoint. Called on Cyclone's threads: short, no
/// waiting, no destruction of the endpoint itself.
struct EndpointCallbacks {
  /// Readers: samples wait to be taken. On the receive thread, once per arrival.
  std::function<void()> data_available;
  /// The number of matched peers is now `current`.
  std::function<void(int current)> matched;
  /// A peer asks for a policy that we do not offer, or offers less than we ask for:
  /// it will not be heard. Names the policy ("reliability", "deadline", …).
  std::function<void(const std::string& policy)> incompatible_qos;
};

/// What is known of a sample besides its contents.
struct SampleInfo {
  bool valid = false;          ///< false: no contents but the key, only a change of state
  bool writers_alive = false;  ///< false: the last writer of the instance has left
  std::int64_t stamp_ns = 0;   ///< when it was written, on the writer's system clock
  std::uint64_t writer = 0;    ///< the writer, within this process; see Reader::writer_guid
  std::uint64_t instance = 0;  ///< what the key names, within this process
};

/// Translates what Cyclone says of a sample.
[[nodiscard]] inline SampleInfo sample_info(const dds_sample_info_t& raw) noexcept {
  return {raw.valid_data, raw.instance_state == DDS_ALIVE_INSTANCE_STATE, raw.source_timestamp,
          raw.publication_handle, raw.instance_handle};
}

/// The part of a reader or writer that knows no type.
class Endpoint {
 public:
  [[nodiscard]] dds_entity_t handle() const noexcept { return handle_; }
  /// Returns how this endpoint is called in the network.
  [[nodiscard]] const Guid& guid() const noexcept { return guid_; }

 protected:
  Endpoint() = default;
  ~Endpoint() { close(); }
  Endpoint(Endpoint&& other) noexcept { swap(other); }
  Endpoint& operator=(Endpoint&& other) noexcept {
    if (this != &other) {
      close();
      swap(other);
    }
    return *this;
  }

  /// Throws Error where Cyclone refuses. `depth` samples an instance wait for the taker.
  void open_reader(const Participant& participant, const TopicSpec& spec,
                   EndpointCallbacks callbacks, int depth);
  void open_writer(const Participant& participant, const TopicSpec& spec,
                   EndpointCallbacks callbacks);
  void close() noexcept;
  void swap(Endpoint& other) noexcept {
    std::swap(handle_, other.handle_);
    std::swap(topic_, other.topic_);
    std::swap(guid_, other.guid_);
    std::swap(callbacks_, other.callbacks_);
  }

 private:
  void open_topic(const Participant& participant, const TopicSpec& spec);
  void finish(dds_entity_t handle, const char* what, const TopicSpec& spec);

  dds_entity_t handle_ = 0;
  dds_entity_t topic_ = 0;
  Guid guid_{};
  std::unique_ptr<EndpointCallbacks> callbacks_;  // at a stable address: listeners point to it
};

/// Receives samples of the topic that carries `T`.
///
/// Threads: any, but one sample goes to one taker. Must not outlive its participant.
template <class T>
class Reader : public Endpoint {
 public:
  Reader() = default;
  /// Keeps the last `depth` samples of each instance until they are taken.
  explicit Reader(const Participant& participant, EndpointCallbacks callbacks = {},
                  int depth = topic<T>().depth) {
    open_reader(participant, topic<T>(), std::move(callbacks), depth);
  }

  /// Copies the next sample into `sample`; false where none waits. Allocates nothing.
  bool take(T& sample, SampleInfo& info) noexcept requires kFixedSize<T> {
    void* place = &sample;
    dds_sample_info_t raw;
    if (dds_take(handle(), &place, &raw, 1, 1) <= 0) return false;
    info = sample_info(raw);
    return true;
  }

  /// Calls `use(const T&, const SampleInfo&)` for each waiting sample, at most `limit`;
  /// references end with the call. Returns their number.
  template <class Use>
  int take_each(Use&& use, int limit = 4096) {
    int taken = 0;
    while (taken < limit) {
      void* sample = nullptr;
      dds_sample_info_t raw;
      if (dds_take(handle(), &sample, &raw, 1, 1) <= 0) break;
      ++taken;
      const Loan loan{handle(), sample};
      use(*static_cast<const T*>(sample), sample_info(raw));
    }
    return taken;
  }

  /// Calls `use` with the latest valid sample of any instance and leaves it in place.
  /// Returns false where there is none.
  template <class Use>
  bool read_latest(Use&& use) {
    void* sample = nullptr;
    dds_sample_info_t raw;
    if (dds_read(handle(), &sample, &raw, 1, 1) <= 0) return false;
    const Loan loan{handle(), sample};
    if (!raw.valid_data) return false;
    use(*static_cast<const T*>(sample), sample_info(raw));
    return true;
  }

  /// Returns the GUID of the writer of a sample, none where it has left. Allocates.
  [[nodiscard]] std::optional<Guid> writer_guid(std::uint64_t writer) const noexcept {
    dds_builtintopic_endpoint_t* data = dds_get_matched_publication_data(handle(), writer);
    if (data == nullptr) return std::nullopt;
    const Guid guid = guid_of(data->key.v);
    dds_builtintopic_free_endpoint(data);
    return guid;
  }

  /// Returns the partitions of the writer of a sample. Allocates.
  [[nodiscard]] std::vector<std::string> writer_partitions(std::uint64_t writer) const {
    std::vector<std::string> names;
    dds_builtintopic_endpoint_t* data = dds_get_matched_publication_data(handle(), writer);
    if (data == nullptr) return names;
    std::uint32_t count = 0;
    char** partitions = nullptr;
    if (dds_qget_partition(data->qos, &count, &partitions)) {
      for (std::uint32_t i = 0; i < count; ++i) {
        names.emplace_back(partitions[i]);
        dds_free(partitions[i]);
      }
      dds_free(partitions);
    }
    dds_builtintopic_free_endpoint(data);
    return names;
  }

  /// Returns the GUIDs of all writers that this reader hears. Allocates.
  [[nodiscard]] std::vector<Guid> matched_writers() const {
    dds_instance_handle_t handles[64];
    const dds_return_t count = dds_get_matched_publications(handle(), handles, 64);
    std::vector<Guid> guids;
    for (int i = 0; i < count && i < 64; ++i) {
      if (const std::optional<Guid> guid = writer_guid(handles[i])) guids.push_back(*guid);
    }
    return guids;
  }

  /// Returns the number of writers heard.
  [[nodiscard]] int matched() const noexcept {
    const dds_return_t count = dds_get_matched_publications(handle(), nullptr, 0);
    return count > 0 ? count : 0;
  }

 private:
  struct Loan {
    dds_entity_t reader;
    void* sample;
    ~Loan() { dds_return_loan(reader, &sample, 1); }
  };
};

/// Sends samples on the topic that carries `T`.
///
/// Threads: any. Must not outlive its participant.
template <class T>
class Writer : public Endpoint {
 public:
  Writer() = default;
  explicit Writer(const Participant& participant, EndpointCallbacks callbacks = {}) {
    open_writer(participant, topic<T>(), std::move(callbacks));
  }

  /// Sends `sample`; false where Cyclone refuses it (a sequence beyond its bound, no
  /// room within 10 ms for a reliable topic). Allocates nothing for fixed-size types.
  bool write(const T& sample) noexcept { return dds_write(handle(), &sample) == DDS_RETCODE_OK; }

  /// Tells readers that this writer has left the sample's instance.
  bool leave(const T& sample) noexcept {
    return dds_unregister_instance(handle(), &sample) == DDS_RETCODE_OK;
  }

  /// Tells readers that the sample's instance is gone, and forgets it for late joiners.
  bool dispose(const T& sample) noexcept {
    return dds_dispose(handle(), &sample) == DDS_RETCODE_OK;
  }

  /// Waits until every matched reader has what was written; reliable topics only.
  bool wait_for_acknowledgements(std::chrono::nanoseconds timeout) noexcept {
    return dds_wait_for_acks(handle(), timeout.count()) == DDS_RETCODE_OK;
  }

  /// Returns the number of readers reached.
  [[nodiscard]] int matched() const noexcept {
    const dds_return_t count = dds_get_matched_subscriptions(handle(), nullptr, 0);
    return count > 0 ? count : 0;
  }
};

/// Waits on one thread for data of several readers, and for a call to leave.
class WaitSet {
 public:
  /// Throws Error where Cyclone refuses. May serve readers of several domains.
  WaitSet();
  ~WaitSet();
  WaitSet(const WaitSet&) = delete;
  WaitSet& operator=(const WaitSet&) = delete;

  /// Wakes `wait` when `reader` has samples. The reader must outlive this wait set.
  void attach(const Endpoint& reader);
  /// Returns true when a reader has samples, false on `wake` or after `timeout`.
  bool wait(std::chrono::nanoseconds timeout) noexcept;
  /// Ends a `wait`, now or the next one. Threads: any.
  void wake() noexcept;

 private:
  dds_entity_t waitset_ = 0;
  dds_entity_t guard_ = 0;
  std::vector<dds_entity_t> conditions_;
};

}  // namespace suture
