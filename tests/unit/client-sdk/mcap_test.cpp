// SPDX-License-Identifier: GPL-3.0-or-later
// What is written can be read, and what is damaged reads as far as it is whole. That the
// files are MCAP to others as well: tests/interop.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/resource.h>

#include <algorithm>
#include <optional>
#include <random>

#include "mcap/reader.hpp"
#include "mcap/writer.hpp"
#include "support/temporary_folder.hpp"

namespace suture::mcap {
namespace {

using sutured::testing::read_file;
using ::testing::HasSubstr;

constexpr std::uint64_t kStart_ns = 1'700'000'000'000'000'000;

struct Got {
  std::string topic;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0, publish_time_ns = 0;
  std::string data;
  bool operator==(const Got&) const = default;
};

struct Outcome {
  std::vector<Got> messages;
  std::vector<Metadata> metadata;
  std::string damage;
};

Outcome read_all(const std::string& path) {
  Outcome outcome;
  Reader reader(path);
  Message message;
  while (reader.next(message)) {
    outcome.messages.push_back(
        {reader.channel(message).topic,
         message.sequence,
         message.log_time_ns,
         message.publish_time_ns,
         {reinterpret_cast<const char*>(message.data.data()), message.data.size()}});
  }
  EXPECT_FALSE(reader.next(message)) << "the end is not the end";
  outcome.metadata = reader.metadata();
  outcome.damage = reader.damage();
  return outcome;
}

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span(text));
}

class Mcap : public ::testing::Test {
 protected:
  /// A file of three chunks with two channels, and metadata after the first.
  std::vector<Got> write_three_chunks(const std::string& path, bool finish = true) {
    Writer writer(path, Writer::Existing::kRefuse, "", "test");
    const std::uint16_t schema = writer.add_schema("a::B", "omgidl", "struct B { long x; };");
    const std::uint16_t channels[] = {writer.add_channel(schema, "one", "cdr"),
                                      writer.add_channel(schema, "two", "cdr")};
    std::mt19937 random(7);
    std::vector<Got> written;
    for (std::uint32_t i = 0; i < 30; ++i) {
      std::string data(random() % 40, '\0');
      std::generate(data.begin(), data.end(), [&] { return static_cast<char>(random()); });
      const Got got{i % 3 == 0 ? "two" : "one", i, kStart_ns + 1000 * i, kStart_ns + 999 * i, data};
      writer.write(Message{channels[i % 3 == 0 ? 1 : 0], i, got.log_time_ns, got.publish_time_ns,
                           bytes_of(data)});
      written.push_back(got);
      if (i % 10 == 9) writer.flush();
      if (i == 9) writer.write(Metadata{"session", {{"scene", "block"}, {"epoch", "7"}}});
    }
    if (finish) writer.finish();
    return written;
  }

  /// The messages are some of `all`, in their order.
  static bool are_some_of(const std::vector<Got>& messages, const std::vector<Got>& all) {
    auto place = all.begin();
    for (const Got& got : messages) {
      place = std::find(place, all.end(), got);
      if (place == all.end()) return false;
      ++place;
    }
    return true;
  }

  /// Reads a damaged file: an Error, or messages that were written and a word about the rest.
  std::optional<Outcome> read_damaged(const std::string& content, const std::vector<Got>& all) {
    const std::string path = folder_.write("damaged.mcap", content);
    try {
      const Outcome outcome = read_all(path);
      EXPECT_TRUE(are_some_of(outcome.messages, all));
      EXPECT_THAT(outcome.damage, ::testing::AnyOf("", HasSubstr("damaged.mcap: byte ")));
      return outcome;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr("damaged.mcap: "));
      return std::nullopt;
    }
  }

  sutured::testing::TemporaryFolder folder_;
};

TEST_F(Mcap, ReadsWhatWasWritten) {
  const std::string path = folder_.path("whole.mcap");
  const std::vector<Got> written = write_three_chunks(path);
  const Outcome outcome = read_all(path);
  EXPECT_EQ(outcome.messages, written);
  EXPECT_EQ(outcome.damage, "");
  ASSERT_EQ(outcome.metadata.size(), 1U);
  EXPECT_EQ(outcome.metadata[0].values.at("scene"), "block");
}

TEST_F(Mcap, ChannelsCarryTheirSchemas) {
  const std::string path = folder_.path("whole.mcap");
  write_three_chunks(path);
  Reader reader(path);
  Message message;
  ASSERT_TRUE(reader.next(message));
  const Channel& channel = reader.channel(message);
  EXPECT_EQ(channel.encoding, "cdr");
  const Schema* schema = reader.schema(channel);
  ASSERT_NE(schema, nullptr);
  EXPECT_EQ(schema->name, "a::B");
  EXPECT_EQ(schema->encoding, "omgidl");
  EXPECT_EQ(schema->data, "struct B { long x; };");
}

TEST_F(Mcap, ALargeMessageIsAChunkOfItsOwn) {
  const std::string path = folder_.path("large.mcap");
  Writer writer(path, Writer::Existing::kRefuse, "", "test");
  const std::uint16_t channel = writer.add_channel(writer.add_schema("a", "b", "c"), "t", "cdr");
  const std::string data(3U << 20U, 'x');
  writer.write(Message{channel, 0, 1, 1, bytes_of(data)});
  EXPECT_FALSE(writer.pending());
  writer.finish();
  const Outcome outcome = read_all(path);
  ASSERT_EQ(outcome.messages.size(), 1U);
  EXPECT_EQ(outcome.messages[0].data, data);
}

TEST_F(Mcap, AnEmptyRecordingIsWhole) {
  const std::string path = folder_.path("empty.mcap");
  Writer writer(path, Writer::Existing::kRefuse, "", "test");
  writer.finish();
  const Outcome outcome = read_all(path);
  EXPECT_TRUE(outcome.messages.empty());
  EXPECT_EQ(outcome.damage, "");
}

TEST_F(Mcap, WhatIsReplacedStaysUntilSomethingIsWritten) {
  const std::string path = folder_.path("old.mcap");
  const std::vector<Got> old = write_three_chunks(path);
  {
    Writer writer(path, Writer::Existing::kReplace, "", "test");
    EXPECT_TRUE(writer.replaces());
    writer.flush();
  }
  EXPECT_EQ(read_all(path).messages, old);
  Writer writer(path, Writer::Existing::kReplace, "", "test");
  const std::uint16_t channel = writer.add_channel(writer.add_schema("a", "b", "c"), "t", "cdr");
  writer.write(Message{channel, 0, 1, 1, bytes_of("new")});
  writer.finish();
  const Outcome outcome = read_all(path);
  ASSERT_EQ(outcome.messages.size(), 1U);
  EXPECT_EQ(outcome.messages[0].data, "new");
  EXPECT_EQ(outcome.damage, "");
  EXPECT_EQ(writer.size_bytes(), read_file(path).size());
}

TEST_F(Mcap, MetadataInAChunkAreNotKept) {
  std::vector<std::byte> chunk, file;
  ByteSink inner(chunk), sink(file);
  for (int i = 0; i < 1000; ++i) {
    inner.record(Opcode::kMetadata, [&] {
      inner.text("session");
      inner.texts({});
    });
  }
  sink.bytes(std::as_bytes(std::span(kMagic)));
  sink.record(Opcode::kChunk, [&] {
    sink.put(std::uint64_t{0});
    sink.put(std::uint64_t{0});
    sink.put(std::uint64_t{chunk.size()});
    sink.put(std::uint32_t{0});
    sink.text("");
    sink.put(std::uint64_t{chunk.size()});
    sink.bytes(chunk);
  });
  sink.record(Opcode::kDataEnd, [&] { sink.put(std::uint32_t{0}); });
  const std::string path = folder_.write(
      "packed.mcap", std::string(reinterpret_cast<const char*>(file.data()), file.size()));
  const Outcome outcome = read_all(path);
  EXPECT_EQ(outcome.damage, "");
  EXPECT_TRUE(outcome.metadata.empty());
}

TEST_F(Mcap, WithoutItsEndAFileReadsToItsLastChunk) {
  const std::string path = folder_.path("cut.mcap");
  const std::vector<Got> written = write_three_chunks(path, false);
  const Outcome outcome = read_all(path);
  EXPECT_EQ(outcome.messages, written);
  EXPECT_THAT(outcome.damage, HasSubstr("was cut off"));
}

TEST_F(Mcap, CutAtAnyLengthItReadsTheChunksThatAreWhole) {
  const std::string path = folder_.path("whole.mcap");
  const std::vector<Got> written = write_three_chunks(path);
  const std::string whole = read_file(path);
  std::size_t most = 0;
  for (std::size_t length = 0; length < whole.size(); ++length) {
    const std::optional<Outcome> outcome = read_damaged(whole.substr(0, length), written);
    if (!outcome) {
      EXPECT_LT(length, kMagic.size());
      continue;
    }
    EXPECT_EQ(outcome->messages.size() % 10, 0U) << length;
    EXPECT_GE(outcome->messages.size(), most) << "a longer file reads shorter at " << length;
    most = outcome->messages.size();
    EXPECT_TRUE(most == 30 || !outcome->damage.empty()) << length;
  }
  EXPECT_EQ(most, 30U);
}

TEST_F(Mcap, WithAnyByteTurnedItGivesNoMessageThatWasNotWritten) {
  const std::string path = folder_.path("whole.mcap");
  const std::vector<Got> written = write_three_chunks(path);
  const std::string whole = read_file(path);
  for (std::size_t place = 0; place < whole.size(); ++place) {
    for (const int turn : {0x01, 0x80, 0xff}) {
      std::string damaged = whole;
      damaged[place] = static_cast<char>(damaged[place] ^ turn);
      read_damaged(damaged, written);
    }
  }
}

TEST_F(Mcap, NoLengthThatLiesIsBelieved) {
  const std::string path = folder_.path("whole.mcap");
  const std::vector<Got> written = write_three_chunks(path);
  const std::string whole = read_file(path);
  std::mt19937_64 random(11);
  for (std::size_t place = kMagic.size(); place + 8 <= whole.size(); ++place) {
    std::string damaged = whole;
    const std::uint64_t lies[] = {0, UINT64_MAX, UINT32_MAX, 1ULL << 40U, whole.size(), random()};
    std::memcpy(damaged.data() + place, &lies[place % 6], 8);
    read_damaged(damaged, written);
  }
}

TEST_F(Mcap, AWrongChecksumEndsTheReadingThere) {
  const std::string path = folder_.path("whole.mcap");
  const std::vector<Got> written = write_three_chunks(path);
  std::string content = read_file(path);
  // The second chunk's checksum stands behind its opcode, length, two times and a size.
  std::size_t chunk = kMagic.size();
  for (int chunks = 0;;) {
    std::uint64_t length = 0;
    std::memcpy(&length, content.data() + chunk + 1, 8);
    if (content[chunk] == static_cast<char>(Opcode::kChunk) && ++chunks == 2) break;
    chunk += kRecordHead + length;
  }
  content[chunk + kRecordHead + 24] ^= 1;
  const std::optional<Outcome> outcome = read_damaged(content, written);
  ASSERT_TRUE(outcome);
  EXPECT_EQ(outcome->messages.size(), 10U);
  EXPECT_THAT(outcome->damage, HasSubstr("byte " + std::to_string(chunk) + " of"));
  EXPECT_THAT(outcome->damage, HasSubstr("checksum"));
}

TEST_F(Mcap, MessagesOutsideOfChunksAreRead) {
  std::vector<std::byte> bytes;
  ByteSink sink(bytes);
  sink.bytes(std::as_bytes(std::span(kMagic)));
  sink.record(Opcode::kHeader, [&] {
    sink.text("");
    sink.text("another");
  });
  sink.record(Opcode::kChannel, [&] {
    sink.put(std::uint16_t{5});
    sink.put(std::uint16_t{0});
    sink.text("topic");
    sink.text("json");
    sink.texts({{"key", "value"}});
  });
  sink.record(Opcode::kMessage, [&] {
    sink.put(std::uint16_t{5});
    sink.put(std::uint32_t{1});
    sink.put(std::uint64_t{2});
    sink.put(std::uint64_t{3});
    sink.bytes(bytes_of("{}"));
  });
  sink.record(Opcode::kDataEnd, [&] { sink.put(std::uint32_t{0}); });
  const std::string path =
      folder_.write("loose.mcap", {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  const Outcome outcome = read_all(path);
  EXPECT_EQ(outcome.damage, "");
  EXPECT_EQ(outcome.messages, (std::vector<Got>{{"topic", 1, 2, 3, "{}"}}));
}

TEST_F(Mcap, AnExistingFileIsKeptUnlessToldOtherwise) {
  const std::string path = folder_.write("mine.mcap", "precious");
  try {
    Writer(path, Writer::Existing::kRefuse, "", "test");
    FAIL() << "it was replaced";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::kBadInput);
    EXPECT_THAT(error.mend(), HasSubstr("--force"));
  }
  EXPECT_EQ(read_file(path), "precious");
  Writer(path, Writer::Existing::kReplace, "", "test").finish();
  EXPECT_EQ(read_all(path).damage, "");
}

TEST_F(Mcap, PlacesThatAreNoFilesAreRefusedWithTheirName) {
  for (const std::string& path :
       {std::string("/dev/null"), folder_.path("no/such/folder.mcap"), folder_.path("")}) {
    try {
      Writer(path, Writer::Existing::kReplace, "", "test");
      FAIL() << path;
    } catch (const Error& error) {
      EXPECT_THAT(error.what(), HasSubstr(path));
    }
    EXPECT_THROW(Reader{path}, Error) << path;
  }
}

TEST_F(Mcap, WhereTheDiskIsFullWhatWasWrittenStays) {
  const std::string path = folder_.path("full.mcap");
  Writer writer(path, Writer::Existing::kRefuse, "", "test");
  const std::uint16_t channel = writer.add_channel(writer.add_schema("a", "b", "c"), "t", "cdr");
  std::mt19937 random(3);
  const auto write_chunk = [&] {
    std::string data(1U << 20U, '\0');  // that does not compress
    std::generate(data.begin(), data.end(), [&] { return static_cast<char>(random()); });
    writer.write(Message{channel, 0, kStart_ns, kStart_ns, bytes_of(data)});
  };
  write_chunk();
  const std::uint64_t whole = writer.size_bytes();

  // A limit on files stands for the full disk: the kernel writes a part, then refuses.
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const rlimit narrow{whole + 1000, before.rlim_max};
  signal(SIGXFSZ, SIG_IGN);
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &narrow), 0);
  EXPECT_THROW(write_chunk(), Error);
  EXPECT_THROW(writer.finish(), Error);
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);

  EXPECT_EQ(std::filesystem::file_size(path), whole);
  EXPECT_EQ(read_all(path).messages.size(), 1U);
  EXPECT_THROW(writer.finish(), Error) << "a hole in the middle";
}

}  // namespace
}  // namespace suture::mcap
