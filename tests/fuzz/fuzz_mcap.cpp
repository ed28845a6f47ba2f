// SPDX-License-Identifier: GPL-3.0-or-later
// A recording: its messages as far as it is whole, and the fields that a replay looks at.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "mcap/reader.hpp"
#include "sample_facts.hpp"
#include "support/temporary_folder.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const sutured::testing::TemporaryFolder folder;
  const std::string path =
      folder.write("a.mcap", std::string_view(reinterpret_cast<const char*>(data), size));
  try {
    suture::mcap::Reader reader(path);
    suture::mcap::Message message;
    while (reader.next(message)) {
      (void)reader.schema(reader.channel(message));
      for (const suture::TopicSpec& topic : suture::all_topics())
        (void)suture::cli::sample_head(topic, message.data);
      (void)suture::cli::server_facts(message.data);
      (void)suture::cli::step_facts(message.data);
      (void)suture::cli::jaw_facts(message.data);
    }
    if (reader.next(message)) std::abort();
  } catch (const suture::Error& error) {
    if (error.code() != suture::ErrorCode::kBadInput) std::abort();
  }
  return 0;
}
