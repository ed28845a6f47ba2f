// SPDX-License-Identifier: Apache-2.0
#include "protocol/serialized.hpp"

#include <dds/ddsi/ddsi_sertype.h>

#include <memory>
#include <string>
#include <vector>

#include "protocol/topics.hpp"

namespace suture {
namespace {

// Null where the bytes are not a sample of the type: Cyclone checks lengths, bounds, enums
// and strings here, as it does for what the network brings.
ddsi_serdata* deserialise(const ddsi_sertype* type, std::span<const std::byte> bytes) noexcept {
  constexpr std::size_t kHeader = 4, kMost = 64U << 20U;
  if (type == nullptr || bytes.size() < kHeader || bytes.size() > kMost) return nullptr;
  ddsrt_iovec_t part{};
  part.iov_base = const_cast<std::byte*>(bytes.data());  // Cyclone's type; it only reads
  part.iov_len = bytes.size();
  return ddsi_serdata_from_ser_iov(type, SDK_DATA, 1, &part, bytes.size());
}

// Cyclone keeps the description that (de)serialises a type to itself, but every serialised
// sample points to it: so one sample is written and taken within this process, in a
// partition of its own. Returns one reference; null where that fails.
ddsi_sertype* type_of(dds_entity_t participant, dds_entity_t topic, std::size_t sample_size) {
  const std::unique_ptr<dds_qos_t, decltype(&dds_delete_qos)> qos(dds_create_qos(),
                                                                  &dds_delete_qos);
  dds_qset_partition1(qos.get(), kCodecPartition);
  const dds_entity_t publisher = dds_create_publisher(participant, qos.get(), nullptr);
  const dds_entity_t subscriber = dds_create_subscriber(participant, qos.get(), nullptr);
  const dds_entity_t reader = dds_create_reader(subscriber, topic, nullptr, nullptr);
  const dds_entity_t writer = dds_create_writer(publisher, topic, nullptr, nullptr);
  const std::vector<std::uint64_t> zeros(sample_size / sizeof(std::uint64_t) + 1);
  ddsi_sertype* type = nullptr;
  ddsi_serdata* data = nullptr;
  dds_sample_info_t info;
  if (reader > 0 && writer > 0 && dds_write(writer, zeros.data()) == DDS_RETCODE_OK &&
      dds_takecdr(reader, &data, 1, &info, DDS_ANY_STATE) == 1) {
    type = ddsi_sertype_ref(data->type);
    ddsi_serdata_unref(data);
  }
  dds_delete(subscriber);
  dds_delete(publisher);
  return type;
}

}  // namespace

SerializedSample::SerializedSample(ddsi_serdata* data) noexcept : data_(data) {
  if (data_ != nullptr) ddsi_serdata_to_ser_ref(data_, 0, ddsi_serdata_size(data_), &bytes_);
}

SerializedSample::SerializedSample(const SerializedSample& other) noexcept
    : SerializedSample(other.data_ != nullptr ? ddsi_serdata_ref(other.data_) : nullptr) {}

SerializedSample::~SerializedSample() {
  if (data_ == nullptr) return;
  ddsi_serdata_to_ser_unref(data_, &bytes_);
  ddsi_serdata_unref(data_);
}

SampleCodec::SampleCodec(const Participant& participant, const dds_topic_descriptor_t& type,
                         const char* name) {
  const dds_entity_t topic = dds_create_topic(participant.handle(), &type, name, nullptr, nullptr);
  if (topic < 0) throw_dds_error(topic, std::string("making the topic ") + name);
  type_ = type_of(participant.handle(), topic, type.m_size);
  dds_delete(topic);
  if (type_ == nullptr) throw_dds_error(DDS_RETCODE_ERROR, std::string("a sample of ") + name);
}

SampleCodec::~SampleCodec() {
  if (type_ != nullptr) ddsi_sertype_unref(type_);
}

std::optional<SerializedSample> SampleCodec::encode(const void* sample) const noexcept {
  ddsi_serdata* data = ddsi_serdata_from_sample(type_, SDK_DATA, sample);
  if (data == nullptr) return std::nullopt;
  return SerializedSample(data);
}

bool SampleCodec::decode_into(std::span<const std::byte> bytes, void* sample) const noexcept {
  ddsi_serdata* data = deserialise(type_, bytes);
  if (data == nullptr) return false;
  const bool decoded = ddsi_serdata_to_sample(data, sample, nullptr, nullptr);
  ddsi_serdata_unref(data);
  return decoded;
}

SerializedWriter::SerializedWriter(const Participant& participant, const TopicSpec& spec)
    : codec_(participant, *spec.descriptor, spec.name) {
  open_writer(participant, spec, {});
}

bool SerializedWriter::write(std::span<const std::byte> bytes) noexcept {
  ddsi_serdata* data = deserialise(codec_.type_, bytes);
  return data != nullptr && dds_writecdr(handle(), data) == DDS_RETCODE_OK;  // takes over `data`
}

}  // namespace suture
