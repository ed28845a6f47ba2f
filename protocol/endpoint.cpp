// SPDX-License-Identifier: Apache-2.0
#include "protocol/endpoint.hpp"

namespace suture {
namespace {

using QosPtr = std::unique_ptr<dds_qos_t, decltype(&dds_delete_qos)>;
using ListenerPtr = std::unique_ptr<dds_listener_t, decltype(&dds_delete_listener)>;

QosPtr endpoint_qos(const TopicSpec& spec, bool writer, int depth) {
  QosPtr qos(dds_create_qos(), &dds_delete_qos);
  dds_qset_reliability(qos.get(),
                       spec.reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                       DDS_MSECS(10));
  dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, depth);
  // Metadata is what makes types assignable or not; a client built against another
  // version of a type must not be mistaken for one that fits.
  dds_qset_type_consistency(qos.get(), DDS_TYPE_CONSISTENCY_DISALLOW_TYPE_COERCION, false, false,
                            false, false, true);
  if (spec.transient_local) {
    dds_qset_durability(qos.get(), DDS_DURABILITY_TRANSIENT_LOCAL);
    // Without this the history kept for late joiners is one sample, whatever the depth.
    dds_qset_durability_service(qos.get(), 0, DDS_HISTORY_KEEP_LAST, spec.depth,
                                DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
  }
  if (writer) {
    if (spec.deadline_ns > 0) dds_qset_deadline(qos.get(), spec.deadline_ns);
    if (spec.liveliness_ns > 0) {
      dds_qset_liveliness(qos.get(), DDS_LIVELINESS_AUTOMATIC, spec.liveliness_ns);
    }
    // A writer that leaves must not take the last event or status with it.
    dds_qset_writer_data_lifecycle(qos.get(), false);
  }
  return qos;
}

const char* policy_name(std::uint32_t id) {
  switch (id) {
    case DDS_DURABILITY_QOS_POLICY_ID:
      return "durability";
    case DDS_DEADLINE_QOS_POLICY_ID:
      return "deadline";
    case DDS_LATENCYBUDGET_QOS_POLICY_ID:
      return "latency budget";
    case DDS_OWNERSHIP_QOS_POLICY_ID:
      return "ownership";
    case DDS_LIVELINESS_QOS_POLICY_ID:
      return "liveliness";
    case DDS_PARTITION_QOS_POLICY_ID:
      return "partition";
    case DDS_RELIABILITY_QOS_POLICY_ID:
      return "reliability";
    case DDS_DESTINATIONORDER_QOS_POLICY_ID:
      return "destination order";
    case DDS_PRESENTATION_QOS_POLICY_ID:
      return "presentation";
    case DDS_DATA_REPRESENTATION_QOS_POLICY_ID:
      return "data representation";
    case DDS_TYPE_CONSISTENCY_ENFORCEMENT_QOS_POLICY_ID:
      return "type consistency";
    default:
      return "unknown policy";
  }
}

EndpointCallbacks& callbacks_of(void* argument) {
  return *static_cast<EndpointCallbacks*>(argument);
}

void on_data(dds_entity_t /*reader*/, void* argument) { callbacks_of(argument).data_available(); }

void on_publication_matched(dds_entity_t /*writer*/, const dds_publication_matched_status_t status,
                            void* argument) {
  callbacks_of(argument).matched(static_cast<int>(status.current_count));
}

void on_subscription_matched(dds_entity_t /*reader*/,
                             const dds_subscription_matched_status_t status, void* argument) {
  callbacks_of(argument).matched(static_cast<int>(status.current_count));
}

void on_offered_incompatible(dds_entity_t /*writer*/,
                             const dds_offered_incompatible_qos_status_t status, void* argument) {
  callbacks_of(argument).incompatible_qos(policy_name(status.last_policy_id));
}

void on_requested_incompatible(dds_entity_t /*reader*/,
                               const dds_requested_incompatible_qos_status_t status,
                               void* argument) {
  callbacks_of(argument).incompatible_qos(policy_name(status.last_policy_id));
}

}  // namespace

void Endpoint::open_topic(const Participant& participant, const TopicSpec& spec) {
  if (spec.channel != participant.channel()) {
    throw Error(ErrorCode::kBadInput,
                std::string("topic ") + spec.name + " does not travel in this domain",
                "make its endpoint from the participant of the other channel");
  }
  topic_ = dds_create_topic(participant.handle(), spec.descriptor, spec.name, nullptr, nullptr);
  if (topic_ < 0) {
    throw_dds_error(std::exchange(topic_, 0), std::string("making the topic ") + spec.name);
  }
}

void Endpoint::finish(dds_entity_t handle, const char* what, const TopicSpec& spec) {
  if (handle < 0) {
    close();
    throw_dds_error(handle, std::string("making a ") + what + " of " + spec.name);
  }
  handle_ = handle;
  dds_guid_t guid;
  if (dds_get_guid(handle_, &guid) == DDS_RETCODE_OK) guid_ = guid_of(guid.v);
}

void Endpoint::open_reader(const Participant& participant, const TopicSpec& spec,
                           EndpointCallbacks callbacks, int depth) {
  open_topic(participant, spec);
  callbacks_ = std::make_unique<EndpointCallbacks>(std::move(callbacks));
  const ListenerPtr listener(dds_create_listener(callbacks_.get()), &dds_delete_listener);
  if (callbacks_->data_available) dds_lset_data_available(listener.get(), on_data);
  if (callbacks_->matched) dds_lset_subscription_matched(listener.get(), on_subscription_matched);
  if (callbacks_->incompatible_qos) {
    dds_lset_requested_incompatible_qos(listener.get(), on_requested_incompatible);
  }
  finish(dds_create_reader(participant.subscriber(), topic_, endpoint_qos(spec, false, depth).get(),
                           listener.get()),
         "reader", spec);
}

void Endpoint::open_writer(const Participant& participant, const TopicSpec& spec,
                           EndpointCallbacks callbacks) {
  open_topic(participant, spec);
  callbacks_ = std::make_unique<EndpointCallbacks>(std::move(callbacks));
  const ListenerPtr listener(dds_create_listener(callbacks_.get()), &dds_delete_listener);
  if (callbacks_->matched) dds_lset_publication_matched(listener.get(), on_publication_matched);
  if (callbacks_->incompatible_qos) {
    dds_lset_offered_incompatible_qos(listener.get(), on_offered_incompatible);
  }
  finish(dds_create_writer(participant.publisher(), topic_,
                           endpoint_qos(spec, true, spec.depth).get(), listener.get()),
         "writer", spec);
}

void Endpoint::close() noexcept {
  // Deleting a reader or writer waits for its callbacks to end; they may use the handle
  // until then.
  if (handle_ > 0) dds_delete(handle_);
  if (topic_ > 0) dds_delete(topic_);
  handle_ = topic_ = 0;
}

WaitSet::WaitSet() {
  waitset_ = dds_create_waitset(DDS_CYCLONEDDS_HANDLE);
  if (waitset_ < 0) throw_dds_error(waitset_, "making a wait set");
  guard_ = dds_create_guardcondition(DDS_CYCLONEDDS_HANDLE);
  if (guard_ < 0) {
    dds_delete(waitset_);
    throw_dds_error(guard_, "making a guard condition");
  }
  dds_waitset_attach(waitset_, guard_, guard_);
}

WaitSet::~WaitSet() {
  for (const dds_entity_t condition : conditions_) {
    dds_waitset_detach(waitset_, condition);
    dds_delete(condition);
  }
  dds_delete(guard_);
  dds_delete(waitset_);
}

void WaitSet::attach(const Endpoint& reader) {
  const dds_entity_t condition = dds_create_readcondition(reader.handle(), DDS_ANY_STATE);
  if (condition < 0) throw_dds_error(condition, "making a read condition");
  conditions_.push_back(condition);
  const dds_return_t attached = dds_waitset_attach(waitset_, condition, condition);
  if (attached < 0) throw_dds_error(attached, "attaching a reader to a wait set");
}

bool WaitSet::wait(std::chrono::nanoseconds timeout) noexcept {
  dds_attach_t triggered[16];
  const dds_return_t count = dds_waitset_wait(waitset_, triggered, 16, timeout.count());
  bool data = false;
  for (dds_return_t i = 0; i < count && i < 16; ++i) {
    if (triggered[i] == guard_) {
      bool set = false;
      dds_take_guardcondition(guard_, &set);
    } else {
      data = true;
    }
  }
  return data;
}

void WaitSet::wake() noexcept { dds_set_guardcondition(guard_, true); }

}  // namespace suture
