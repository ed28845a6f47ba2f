// SPDX-License-Identifier: Apache-2.0
// Samples as the bytes that travel, for those who pass them on without knowing the type:
// the gateway, the recorder, the replayer.
#pragma once

#include <dds/ddsi/ddsi_serdata.h>

#include <cstddef>
#include <optional>
#include <span>
#include <utility>

#include "protocol/endpoint.hpp"

namespace suture {

/// The bytes of one sample: four of encapsulation header, then XCDR1. Shared with Cyclone,
/// not copied; a copy of this object shares them too. Threads: any.
class SerializedSample {
 public:
  SerializedSample() = default;
  /// Takes over one reference to `data`.
  explicit SerializedSample(ddsi_serdata* data) noexcept;
  SerializedSample(const SerializedSample& other) noexcept;
  SerializedSample(SerializedSample&& other) noexcept { swap(other); }
  SerializedSample& operator=(SerializedSample other) noexcept {
    swap(other);
    return *this;
  }
  ~SerializedSample();

  /// Valid as long as this object or a copy lives.
  [[nodiscard]] std::span<const std::byte> bytes() const noexcept {
    return {static_cast<const std::byte*>(bytes_.iov_base), bytes_.iov_len};
  }

 private:
  void swap(SerializedSample& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(bytes_, other.bytes_);
  }

  ddsi_serdata* data_ = nullptr;
  ddsrt_iovec_t bytes_{};  // holds a reference of its own
};

/// Turns samples into bytes and back, without an endpoint.
///
/// Threads: one at a time. Must not outlive its participant.
class SampleCodec {
 public:
  /// Throws Error where Cyclone refuses the type.
  SampleCodec(const Participant& participant, const dds_topic_descriptor_t& type, const char* name);
  ~SampleCodec();
  SampleCodec(const SampleCodec&) = delete;
  SampleCodec& operator=(const SampleCodec&) = delete;

  /// `sample` is of the C type that the descriptor describes. Nothing where it does not
  /// keep to its type's bounds.
  [[nodiscard]] std::optional<SerializedSample> encode(const void* sample) const noexcept;
  /// Copies bytes into `sample`, a type without pointers; false where they are not such a
  /// sample.
  template <class T>
  [[nodiscard]] bool decode(std::span<const std::byte> bytes,
                            T& sample) const noexcept requires kFixedSize<T> {
    return decode_into(bytes, &sample);
  }
  /// Calls `use(const T&)` with the sample that the bytes are, whatever its type; false where they
  /// are none. Allocates its sequences, which end with the call.
  template <class T, class Use>
  bool with_decoded(std::span<const std::byte> bytes, Use&& use) const {
    T sample{};
    const struct Contents {
      T& sample;
      ~Contents() { dds_sample_free(&sample, topic<T>().descriptor, DDS_FREE_CONTENTS); }
    } contents{sample};
    if (!decode_into(bytes, &sample)) return false;
    use(static_cast<const T&>(sample));
    return true;
  }

 private:
  friend class SerializedWriter;
  bool decode_into(std::span<const std::byte> bytes, void* sample) const noexcept;

  ddsi_sertype* type_ = nullptr;
};

/// Receives the samples of one topic as bytes.
///
/// Threads: any, but one sample goes to one taker. Must not outlive its participant.
class SerializedReader : public Endpoint {
 public:
  SerializedReader() = default;
  /// `depth`: how many samples an instance wait for the taker, before the oldest goes.
  SerializedReader(const Participant& participant, const TopicSpec& spec,
                   EndpointCallbacks callbacks, int depth) {
    open_reader(participant, spec, std::move(callbacks), depth);
  }

  /// Calls `use(SerializedSample, const SampleInfo&)` for each waiting sample, at most
  /// `limit`; an invalid one has only its key. Returns their number.
  template <class Use>
  int take_each(Use&& use, int limit = 4096) {
    int taken = 0;
    for (; taken < limit; ++taken) {
      ddsi_serdata* data = nullptr;
      dds_sample_info_t raw;
      if (dds_takecdr(handle(), &data, 1, &raw, DDS_ANY_STATE) <= 0) break;
      use(SerializedSample(data), sample_info(raw));
    }
    return taken;
  }
};

/// Sends bytes as samples of one topic.
///
/// Threads: one at a time. Must not outlive its participant.
class SerializedWriter : public Endpoint {
 public:
  /// Throws Error where Cyclone refuses.
  SerializedWriter(const Participant& participant, const TopicSpec& spec);

  /// False where the bytes are not a sample of the topic's type, or a reliable topic has no
  /// room for it within 10 ms.
  bool write(std::span<const std::byte> bytes) noexcept;

 private:
  SampleCodec codec_;
};

}  // namespace suture
