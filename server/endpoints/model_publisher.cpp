// SPDX-License-Identifier: GPL-3.0-or-later
#include "endpoints/model_publisher.hpp"

#include "endpoints/wire.hpp"
#include "haptics/realtime.hpp"

namespace sutured::endpoints {

ModelPublisher::ModelPublisher(const suture::Participant& participant,
                               const std::vector<ServedTool>& tools, const ForceService& forces)
    : tools_(tools), forces_(forces), writer_(participant), frozen_rows_(tools.size()) {
  for (const ServedTool& tool : tools) names_.push_back(tool.name);
}

ModelPublisher::~ModelPublisher() { stop(); }

void ModelPublisher::start(haptics::SimulationLoop& loop) {
  thread_ = std::thread([this, &loop] { run(loop); });
}

void ModelPublisher::stop() noexcept {
  stop_.store(true);
  notify();
  if (thread_.joinable()) thread_.join();
}

void ModelPublisher::run(haptics::SimulationLoop& loop) noexcept {
  haptics::name_thread("models");
  suture::v1::HapticModel wire{};
  std::array<suture::v1::ToolCoupling, suture::kModelOthersMax> couplings{};
  std::uint32_t seen = beat_.load(std::memory_order_acquire);
  while (!stop_.load()) {
    beat_.wait(seen, std::memory_order_acquire);
    seen = beat_.load(std::memory_order_acquire);
    const bool heard = writer_.matched() > 0;
    for (std::size_t i = 0; i < tools_.size(); ++i) {
      const haptics::PublishedModel* published = loop.next_model(i);
      if (published == nullptr) continue;
      frozen_rows_[i].store(static_cast<std::uint32_t>(published->model.frozen_rows),
                            std::memory_order_relaxed);
      if (!heard) continue;
      suture::set_text(wire.tool, tools_[i].name);
      suture::set_guid(wire.device, forces_.guid_of_writer(published->writer));
      set_model(wire, *published, tools_[i].channel->limits(), names_, couplings);
      if (tools_[i].channel->stopped()) wire.flags |= suture_v1_MODEL_STOPPED;
      writer_.write(wire);
    }
  }
}

}  // namespace sutured::endpoints
