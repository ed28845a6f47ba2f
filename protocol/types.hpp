// SPDX-License-Identifier: Apache-2.0
// C++ names for the generated wire types, and what is needed to fill them.
// Meaning, units and frames of each field: idl/suture_v1.idl.
#pragma once

#include <suture_v1.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <span>
#include <string_view>
#include <type_traits>

namespace suture::v1 {

using ToolPose = suture_v1_ToolPose;
using ToolState = suture_v1_ToolState;
using ToolForce = suture_v1_ToolForce;
using ToolRendered = suture_v1_ToolRendered;
using Mapping = suture_v1_Mapping;
using ToolCoupling = suture_v1_ToolCoupling;
using HapticModel = suture_v1_HapticModel;
using DeviceProfile = suture_v1_DeviceProfile;
using TriangleGroup = suture_v1_TriangleGroup;
using MeshTopology = suture_v1_MeshTopology;
using MeshFrame = suture_v1_MeshFrame;
using ToolView = suture_v1_ToolView;
using Puncture = suture_v1_Puncture;
using NeedleState = suture_v1_NeedleState;
using ThreadEnd = suture_v1_ThreadEnd;
using ThreadState = suture_v1_ThreadState;
using ContactPoint = suture_v1_ContactPoint;
using ContactState = suture_v1_ContactState;
using Bite = suture_v1_Bite;
using Quality = suture_v1_Quality;
using EventKind = suture_v1_EventKind;
using Event = suture_v1_Event;
using ServerState = suture_v1_ServerState;
using Percentiles = suture_v1_Percentiles;
using ToolStatus = suture_v1_ToolStatus;
using StageTime = suture_v1_StageTime;
using ServerStatus = suture_v1_ServerStatus;
using CommandKind = suture_v1_CommandKind;
using Command = suture_v1_Command;
using CommandResult = suture_v1_CommandResult;
using CommandReply = suture_v1_CommandReply;

}  // namespace suture::v1

namespace suture {

/// Identifies a DDS writer or reader in the whole network.
using Guid = std::array<std::uint8_t, 16>;

inline constexpr Guid kNobody{};

inline Guid guid_of(const std::uint8_t (&wire)[16]) noexcept {
  Guid guid;
  std::memcpy(guid.data(), wire, guid.size());
  return guid;
}

inline void set_guid(std::uint8_t (&wire)[16], const Guid& guid) noexcept {
  std::memcpy(wire, guid.data(), guid.size());
}

/// Copies `text` into a bounded wire string, cut where it does not fit (between
/// UTF-8 characters). Returns whether all of it fitted.
template <std::size_t N>
bool set_text(char (&wire)[N], std::string_view text) noexcept {
  std::size_t length = text.size() < N ? text.size() : N - 1;
  if (length < text.size()) {
    while (length > 0 && (static_cast<unsigned char>(text[length]) & 0xC0U) == 0x80U) --length;
  }
  std::memcpy(wire, text.data(), length);
  std::memset(wire + length, 0, N - length);
  return length == text.size();
}

/// Views a bounded wire string; safe where no terminator is left.
template <std::size_t N>
std::string_view text_of(const char (&wire)[N]) noexcept {
  return {wire, strnlen(wire, N)};
}

/// Returns the key of poses and forces: the 64-bit FNV-1a hash of the tool's name.
[[nodiscard]] constexpr std::uint64_t tool_id(std::string_view name) noexcept {
  std::uint64_t hash = 0xcbf29ce484222325U;
  for (const char c : name) {
    hash ^= static_cast<unsigned char>(c);
    hash *= 0x100000001b3U;
  }
  return hash;
}

/// Lends caller-owned elements to a wire sequence for one `write`; nothing is copied or freed.
template <class Sequence, class Element>
void lend(Sequence& wire, std::span<const Element> elements) noexcept {
  using Target = std::remove_pointer_t<decltype(wire._buffer)>;
  static_assert(std::is_same_v<Target, Element>);
  wire._maximum = wire._length = static_cast<std::uint32_t>(elements.size());
  wire._buffer = const_cast<Element*>(elements.data());
  wire._release = false;
}

/// Views a received wire sequence for as long as its sample lives.
template <class Sequence>
auto span_of(const Sequence& wire) noexcept {
  using Element = std::remove_pointer_t<decltype(wire._buffer)>;
  return std::span<const Element>(wire._buffer, wire._length);
}

/// Returns the time now on the system clock (ns since the Unix epoch): for stamps.
[[nodiscard]] std::int64_t wall_clock_ns() noexcept;

/// Returns the time now on the monotonic clock (ns): for ages and periods.
[[nodiscard]] std::int64_t monotonic_ns() noexcept;

}  // namespace suture
