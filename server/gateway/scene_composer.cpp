// SPDX-License-Identifier: GPL-3.0-or-later
#include "gateway/scene_composer.hpp"

#include <foxglove_scene.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <span>
#include <utility>

#include "gateway/feed.hpp"
#include "idl/idl_text.hpp"
#include "protocol/topics.hpp"

namespace sutured::gateway {
namespace {

namespace v1 = suture::v1;
using Colour = foxglove_Color;
using Point = foxglove_Point3;
using Vec3 = std::array<double, 3>;

constexpr char kFrame[] = "world";
constexpr std::size_t kThingsMax = 256;  // of one kind: names come from the network
constexpr double kArrowPerNewton_m = 0.01;
constexpr double kSmallestArrow_n = 0.005;
constexpr double kAxis_m = 0.004;
constexpr double kFullTension_n = 2.0;
constexpr double kSmallestScale_pa = 1e3;
constexpr double kScaleDecay = 0.98;  // a frame
constexpr Colour kSteel{0.75, 0.77, 0.80, 1.0};
constexpr Colour kForce{0.95, 0.55, 0.10, 1.0};
constexpr Colour kPuncture{0.15, 0.15, 0.60, 1.0};
constexpr Colour kContact{0.20, 0.65, 0.30, 1.0};

// From tissue at rest over amber to dark red.
Colour stress_colour(double share) {
  constexpr std::array<std::array<double, 3>, 4> kStops{
      {{0.90, 0.72, 0.68}, {0.95, 0.75, 0.30}, {0.88, 0.30, 0.12}, {0.45, 0.03, 0.10}}};
  // What is no number is drawn as at rest.
  const double at = (share > 0.0 ? std::min(share, 1.0) : 0.0) * (kStops.size() - 1);
  const std::size_t i = std::min(static_cast<std::size_t>(at), kStops.size() - 2);
  const double t = at - static_cast<double>(i);
  const auto mix = [&](std::size_t k) {
    return kStops[i][k] + t * (kStops[i + 1][k] - kStops[i][k]);
  };
  return {mix(0), mix(1), mix(2), 1.0};
}

// From slack grey-blue to taut red.
Colour tension_colour(double tension_n) {
  const double share = std::clamp(tension_n / kFullTension_n, 0.0, 1.0);
  return {0.20 + 0.75 * share, 0.30 * (1.0 - share) + 0.10, 0.65 * (1.0 - share) + 0.05, 1.0};
}

foxglove_Pose pose_at(const Vec3& p, const std::array<double, 4>& q = {0, 0, 0, 1}) {
  return {{p[0], p[1], p[2]}, {q[0], q[1], q[2], q[3]}};
}

// The shortest turn that takes +x into `direction`, as a quaternion.
std::array<double, 4> turn_of_x_to(const Vec3& direction) {
  const double length = std::hypot(direction[0], direction[1], direction[2]);
  const double x = direction[0] / length, y = direction[1] / length, z = direction[2] / length;
  if (x < -1.0 + 1e-12) return {0, 0, 1, 0};
  // x × d = (0, −z, y), and w = 1 + x · d
  const double norm = std::sqrt(2.0 * (1.0 + x));
  return {0.0, -z / norm, y / norm, (1.0 + x) / norm};
}

std::array<double, 4> product(const std::array<double, 4>& a, const std::array<double, 4>& b) {
  return {a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
          a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
          a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
          a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]};
}

foxglove_ArrowPrimitive arrow(const Vec3& from, const std::array<double, 4>& turn, double length_m,
                              double diameter_m, const Colour& colour) {
  const double head_m = std::min(3.0 * diameter_m, 0.5 * length_m);
  return {pose_at(from, turn), length_m - head_m, diameter_m, head_m, 2.0 * diameter_m, colour};
}

foxglove_SpherePrimitive sphere(const Vec3& at, double diameter_m, const Colour& colour) {
  return {pose_at(at), {diameter_m, diameter_m, diameter_m}, colour};
}

// Generated sequences own nothing here: what they point to lives in `Drawing`.
template <class Sequence, class Element>
void lend(Sequence& wire, const std::vector<Element>& elements) {
  suture::lend(wire, std::span<const Element>(elements));
}

/// One update being made, with the memory that its sequences point to.
class Drawing {
 public:
  explicit Drawing(std::int64_t stamp_ns)
      : stamp_{static_cast<std::uint32_t>(stamp_ns / 1'000'000'000),
               static_cast<std::uint32_t>(stamp_ns % 1'000'000'000)} {}

  struct Entity {
    std::string id;
    std::vector<foxglove_ArrowPrimitive> arrows;
    std::vector<foxglove_SpherePrimitive> spheres;
    std::vector<foxglove_LinePrimitive> lines;
    std::vector<foxglove_TriangleListPrimitive> triangles;
    std::vector<foxglove_KeyValuePair> metadata;
    std::deque<std::vector<Point>> points;
    std::deque<std::vector<Colour>> colours;
    std::vector<std::uint32_t> indices;
    std::deque<std::string> texts;
  };
  Entity& entity(std::string id) {
    entities_.emplace_back();
    entities_.back().id = std::move(id);
    return entities_.back();
  }

  foxglove_SceneUpdate& finish() {
    for (Entity& entity : entities_) {
      foxglove_SceneEntity wire{};
      wire.timestamp = stamp_;
      wire.frame_id = const_cast<char*>(kFrame);  // idlc's type; nobody writes to it
      wire.id = entity.id.data();
      lend(wire.metadata, entity.metadata);
      lend(wire.arrows, entity.arrows);
      lend(wire.spheres, entity.spheres);
      lend(wire.lines, entity.lines);
      lend(wire.triangles, entity.triangles);
      wire_.push_back(wire);
    }
    lend(update_.entities, wire_);
    return update_;
  }

 private:
  foxglove_Time stamp_;
  std::deque<Entity> entities_;
  std::vector<foxglove_SceneEntity> wire_;
  foxglove_SceneUpdate update_{};
};

void draw_course(Drawing::Entity& entity, std::span<const double> course_m, double diameter_m,
                 const Colour& colour, std::span<const double> tension_n) {
  std::vector<Point>& points = entity.points.emplace_back();
  for (std::size_t i = 0; i + 2 < course_m.size(); i += 3)
    points.push_back({course_m[i], course_m[i + 1], course_m[i + 2]});
  if (points.empty()) return;
  std::vector<Colour>& colours = entity.colours.emplace_back();
  if (tension_n.size() + 1 == points.size() && !tension_n.empty())
    for (std::size_t i = 0; i < points.size(); ++i)
      colours.push_back(tension_colour(tension_n[std::min(i, tension_n.size() - 1)]));
  foxglove_LinePrimitive line{};
  line.type = foxglove_LINE_STRIP;
  line.pose = pose_at({});
  line.thickness = diameter_m;
  line.color = colour;
  lend(line.points, points);
  lend(line.colors, colours);
  entity.lines.push_back(line);
}

template <class Element, class Sequence>
void copy(std::vector<Element>& to, const Sequence& from) {
  const auto all = suture::span_of(from);
  to.assign(all.begin(), all.end());
}

Vec3 vec3(const double (&wire)[3]) { return {wire[0], wire[1], wire[2]}; }

// The thing of that name; null where there are too many of its kind.
template <class Thing>
Thing* thing(std::map<std::string, Thing>& all, std::string_view name) {
  const std::string key(name);
  if (!all.contains(key) && all.size() >= kThingsMax) return nullptr;
  return &all[key];
}

}  // namespace

struct SceneComposer::Readers {
  explicit Readers(const suture::Participant& mesh)
      : topologies(mesh), frames(mesh), needles(mesh), threads(mesh), tools(mesh), contacts(mesh) {}
  suture::Reader<v1::MeshTopology> topologies;
  suture::Reader<v1::MeshFrame> frames;
  suture::Reader<v1::NeedleState> needles;
  suture::Reader<v1::ThreadState> threads;
  suture::Reader<v1::ToolView> tools;
  suture::Reader<v1::ContactState> contacts;
};

SceneComposer::SceneComposer(const suture::Participant& mesh)
    : mesh_(mesh), codec_(mesh, foxglove_SceneUpdate_desc, suture::kComposedScene) {}

SceneComposer::~SceneComposer() = default;

Channel SceneComposer::channel(std::uint32_t id) {
  return {id, suture::kComposedScene, "foxglove::SceneUpdate", suture::foxglove_scene_idl()};
}

void SceneComposer::watch(bool wanted) {
  watched_ = wanted;
  left_ = std::chrono::steady_clock::now();
  if (wanted && !readers_) readers_ = std::make_unique<Readers>(mesh_);
  if (wanted && !tissues_.empty()) news_ = true;  // who comes again gets what there is
}

void SceneComposer::close_idle(std::chrono::steady_clock::time_point now) {
  if (!readers_ || watched_ || now - left_ < kReaderStays) return;
  readers_.reset();
  begin_epoch(0);
  news_ = false;
  stamp_ns_ = 0;
}

void SceneComposer::begin_epoch(std::uint64_t epoch) {
  epoch_ = epoch;
  tissues_.clear();
  needles_.clear();
  threads_.clear();
  tools_.clear();
  contacts_.clear();
  peak_pa_ = 0.0;
}

void SceneComposer::read() {
  // The first sample of another epoch ends what was drawn of the one before.
  const auto fits = [this](const auto& sample, const suture::SampleInfo& info) {
    if (!info.valid || sample.epoch < epoch_) return false;
    if (sample.epoch > epoch_) begin_epoch(sample.epoch);
    stamp_ns_ = std::max(stamp_ns_, sample.stamp_ns);
    news_ = true;
    return true;
  };
  readers_->topologies.take_each([&](const v1::MeshTopology& wire, const suture::SampleInfo& info) {
    if (!fits(wire, info)) return;
    Tissue* tissue = thing(tissues_, suture::text_of(wire.body));
    if (tissue == nullptr) return;
    tissue->revision = wire.revision;
    copy(tissue->triangle, wire.triangle);
    copy(tissue->position_m, wire.rest_position_m);
    tissue->von_mises_pa.assign(tissue->position_m.size() / 3, 0.0F);
    const auto vertices = static_cast<std::uint32_t>(tissue->von_mises_pa.size());
    if (std::any_of(tissue->triangle.begin(), tissue->triangle.end(),
                    [&](std::uint32_t v) { return v >= vertices; }))
      tissue->triangle.clear();
  });
  readers_->frames.take_each([&](const v1::MeshFrame& wire, const suture::SampleInfo& info) {
    if (!fits(wire, info)) return;
    const auto tissue = tissues_.find(std::string(suture::text_of(wire.body)));
    if (tissue == tissues_.end() || tissue->second.revision != wire.revision ||
        wire.position_m._length != tissue->second.position_m.size())
      return;
    copy(tissue->second.position_m, wire.position_m);
    if (wire.von_mises_pa._length == tissue->second.von_mises_pa.size())
      copy(tissue->second.von_mises_pa, wire.von_mises_pa);
  });
  const auto punctures = [](const auto& wire) {
    std::vector<Vec3> points;
    for (const v1::Puncture& puncture : suture::span_of(wire))
      points.push_back(vec3(puncture.position_m));
    return points;
  };
  readers_->needles.take_each([&](const v1::NeedleState& wire, const suture::SampleInfo& info) {
    Line* needle = fits(wire, info) ? thing(needles_, suture::text_of(wire.needle)) : nullptr;
    if (needle == nullptr) return;
    needle->diameter_m = wire.diameter_m;
    copy(needle->course_m, wire.course_m);
    needle->punctures_m = punctures(wire.punctures);
  });
  readers_->threads.take_each([&](const v1::ThreadState& wire, const suture::SampleInfo& info) {
    Line* thread = fits(wire, info) ? thing(threads_, suture::text_of(wire.thread)) : nullptr;
    if (thread == nullptr) return;
    thread->diameter_m = wire.diameter_m;
    copy(thread->course_m, wire.course_m);
    copy(thread->tension_n, wire.segment_tension_n);
    thread->punctures_m = punctures(wire.punctures);
  });
  readers_->tools.take_each([&](const v1::ToolView& wire, const suture::SampleInfo& info) {
    Tool* tool = fits(wire, info) ? thing(tools_, suture::text_of(wire.tool)) : nullptr;
    if (tool == nullptr) return;
    tool->position_m = vec3(wire.position_m);
    tool->force_n = vec3(wire.force_n);
    std::copy(std::begin(wire.orientation_xyzw), std::end(wire.orientation_xyzw),
              tool->orientation_xyzw.begin());
  });
  readers_->contacts.take_each([&](const v1::ContactState& wire, const suture::SampleInfo& info) {
    if (!fits(wire, info)) return;
    contacts_.clear();
    for (const v1::ContactPoint& point : suture::span_of(wire.points))
      contacts_.push_back({vec3(point.position_m), point.force_n});
  });
}

std::optional<suture::SerializedSample> SceneComposer::compose() {
  if (!readers_) return std::nullopt;
  read();
  if (!watched_ || !std::exchange(news_, false)) return std::nullopt;

  double peak_pa = kSmallestScale_pa;
  for (const auto& [name, tissue] : tissues_)
    for (const float stress_pa : tissue.von_mises_pa)
      if (std::isfinite(stress_pa)) peak_pa = std::max(peak_pa, static_cast<double>(stress_pa));
  peak_pa_ = std::max(peak_pa, kScaleDecay * peak_pa_);

  Drawing drawing(stamp_ns_);
  for (auto& [name, tissue] : tissues_) {
    Drawing::Entity& entity = drawing.entity("tissue/" + name);
    std::vector<Point>& points = entity.points.emplace_back();
    std::vector<Colour>& colours = entity.colours.emplace_back();
    for (std::size_t v = 0; v < tissue.von_mises_pa.size(); ++v) {
      const float* const p = &tissue.position_m[3 * v];
      points.push_back(
          {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])});
      colours.push_back(stress_colour(static_cast<double>(tissue.von_mises_pa[v]) / peak_pa_));
    }
    entity.indices = tissue.triangle;
    foxglove_TriangleListPrimitive triangles{};
    triangles.pose = pose_at({});
    lend(triangles.points, points);
    lend(triangles.colors, colours);
    lend(triangles.indices, entity.indices);
    entity.triangles.push_back(triangles);
    entity.texts.emplace_back("von_mises_kpa_at_full_colour");
    entity.texts.push_back(std::to_string(peak_pa_ * 1e-3));
    entity.metadata.push_back({entity.texts[0].data(), entity.texts[1].data()});
  }
  for (const auto& [name, needle] : needles_) {
    Drawing::Entity& entity = drawing.entity("needle/" + name);
    draw_course(entity, needle.course_m, needle.diameter_m, kSteel, {});
    for (const Vec3& at : needle.punctures_m)
      entity.spheres.push_back(sphere(at, 2.0 * needle.diameter_m, kPuncture));
  }
  for (const auto& [name, thread] : threads_) {
    Drawing::Entity& entity = drawing.entity("thread/" + name);
    draw_course(entity, thread.course_m, thread.diameter_m, tension_colour(0.0), thread.tension_n);
    for (const Vec3& at : thread.punctures_m)
      entity.spheres.push_back(sphere(at, 2.0 * thread.diameter_m, kPuncture));
  }
  for (const auto& [name, tool] : tools_) {
    Drawing::Entity& entity = drawing.entity("tool/" + name);
    const auto& q = tool.orientation_xyzw;
    const double c = std::sqrt(0.5);
    const std::array<std::pair<std::array<double, 4>, Colour>, 3> axes{{
        {q, {0.85, 0.20, 0.20, 1.0}},
        {product(q, {0, 0, c, c}), {0.25, 0.65, 0.25, 1.0}},
        {product(q, {0, -c, 0, c}), {0.25, 0.35, 0.90, 1.0}},
    }};
    for (const auto& [turn, colour] : axes)
      entity.arrows.push_back(arrow(tool.position_m, turn, kAxis_m, 0.05 * kAxis_m, colour));
    const double force_n = std::hypot(tool.force_n[0], tool.force_n[1], tool.force_n[2]);
    if (force_n > kSmallestArrow_n)
      entity.arrows.push_back(arrow(tool.position_m, turn_of_x_to(tool.force_n),
                                    kArrowPerNewton_m * force_n, 4e-4, kForce));
  }
  Drawing::Entity& contacts = drawing.entity("contact");
  for (const Contact& contact : contacts_)
    contacts.spheres.push_back(sphere(contact.position_m, 3e-4, kContact));
  return codec_.encode(&drawing.finish());
}

}  // namespace sutured::gateway
