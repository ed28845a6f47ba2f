// SPDX-License-Identifier: GPL-3.0-or-later
#include "geometry/mesh_file_guard.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <string_view>
#include <utility>

#include "geometry/mesh_file_cursor.hpp"
#include "geometry/regular_file.hpp"

namespace sutured::geometry {

namespace {

// libgmsh keeps tables as long as the largest tag.
constexpr std::uint64_t kTagMax = 50'000'000;

// A broken exporter breaks every line alike: enough is enough.
constexpr std::size_t kFaultsMax = 100;

[[noreturn]] void fail(const std::string& path, std::string what, std::string mend = kMendExport) {
  throw MeshError(path, {{0, "", std::move(what), std::move(mend)}});
}

// Nodes of an element and its dimension; what libgmsh calls type 1, 2, … in MSH files.
struct ElementKind {
  int type;
  std::size_t nodes;
  int dimension;
};
constexpr std::array<ElementKind, 5> kMshKinds{
    {{15, 1, 0}, {1, 2, 1}, {2, 3, 2}, {3, 4, 2}, {4, 4, 3}}};
constexpr std::array<ElementKind, 5> kVtkKinds{
    {{1, 1, 0}, {3, 2, 1}, {5, 3, 2}, {9, 4, 2}, {10, 4, 3}}};

class Guard {
 public:
  Guard(const std::string& path, std::string_view bytes)
      : cursor_(path, bytes), path_(path), bytes_(bytes) {}

  CheckedMeshFile check() {
    if (bytes_.starts_with("$MeshFormat")) {
      walk_msh();
    } else if (bytes_.starts_with("$NOD")) {
      walk_msh1();
    } else {
      walk_vtk();
    }
    if (!faults_.empty()) throw MeshError(path_, std::move(faults_));
    return std::move(file_);
  }

 private:
  void keep(std::size_t start) {
    file_.bytes += cursor_.since(start);
    file_.bytes += '\n';
  }

  void add_node(std::int64_t tag) {
    if (tag < 1 || static_cast<std::uint64_t>(tag) > kTagMax)
      cursor_.fail(
          "node number " + std::to_string(tag) + " is not between 1 and " + std::to_string(kTagMax),
          "renumber the nodes (gmsh FILE -save renumbers)");
    file_.node_tags.push_back(static_cast<std::uint64_t>(tag));
  }

  template <typename Stored = double>
  void read_coordinates(std::uint64_t tag) {
    bool finite = true;
    for (int axis = 0; axis < 3; ++axis)
      finite &= std::isfinite(cursor_.real<Stored>("a coordinate"));
    if (!finite)
      add_fault({cursor_.line(), "node " + std::to_string(tag),
                 "a coordinate is not a finite number", "repair the mesh where it was made"});
  }

  void add_fault(MeshFault fault) {
    faults_.push_back(std::move(fault));
    if (faults_.size() == kFaultsMax) throw MeshError(path_, std::move(faults_));
  }

  // To be called once, when all nodes are known.
  void close_nodes() {
    sorted_tags_ = file_.node_tags;
    refuse_twins(sorted_tags_, "node", "renumber the nodes");
  }

  void refuse_twins(std::vector<std::uint64_t>& tags, const char* of, const char* mend) {
    std::sort(tags.begin(), tags.end());
    const auto twin = std::adjacent_find(tags.begin(), tags.end());
    if (twin != tags.end())
      cursor_.fail("stands twice in the file", mend, of + (' ' + std::to_string(*twin)));
  }

  void count(const ElementKind& kind) {
    file_.tets += kind.dimension == 3;
    file_.triangles += kind.dimension == 2 && kind.nodes == 3;
  }

  // Of two elements of one number, libgmsh drops one from MSH 1 and 2, whatever they are; with
  // MSH 4 nobody could tell two tets apart.
  void note_element(std::int64_t tag, const ElementKind& kind) {
    count(kind);
    if (file_.format != MeshFormat::kMsh4 || kind.dimension == 3)
      element_tags_.push_back(static_cast<std::uint64_t>(tag));
  }
  void close_elements() {
    refuse_twins(element_tags_, "element", "renumber the elements (gmsh FILE -save renumbers)");
    element_tags_ = {};
  }

  // Of an element in MSH 1 and 2: libgmsh drops those of a negative entity, and turns others over.
  void check_group(std::int64_t tag, std::int64_t element) {
    check_tag(tag);
    if (tag < 0)
      cursor_.fail("has the negative group or entity " + std::to_string(tag),
                   "give groups and entities positive numbers, and save it as 4.1",
                   "element " + std::to_string(element));
  }

  void check_node(std::int64_t tag, std::int64_t element) {
    if (tag < 1 || !std::binary_search(sorted_tags_.begin(), sorted_tags_.end(),
                                       static_cast<std::uint64_t>(tag)))
      add_fault({cursor_.line(), "element " + std::to_string(element),
                 "refers to node " + std::to_string(tag) + ", which is not in the file",
                 "repair the mesh where it was made"});
  }

  const ElementKind& element_kind(std::int64_t type, std::int64_t element) {
    const auto& kinds = file_.format == MeshFormat::kVtk ? kVtkKinds : kMshKinds;
    for (const ElementKind& kind : kinds)
      if (kind.type == type) return kind;
    cursor_.fail(
        "has the type " + std::to_string(type) +
            ": only points, lines, triangles, quadrangles and tetrahedra of first order are read",
        "mesh with tetrahedra of first order (gmsh FILE -3 -order 1)",
        "element " + std::to_string(element));
  }

  template <typename Stored>
  std::int64_t read_element_tag() {
    const std::int64_t tag = cursor_.integer<Stored>("an element's number");
    if (tag < 1 || static_cast<std::uint64_t>(tag) > kTagMax)
      cursor_.fail("element number " + std::to_string(tag) + " is not between 1 and " +
                       std::to_string(kTagMax),
                   "renumber the elements");
    return tag;
  }

  template <typename Stored>
  void read_element_nodes(std::int64_t element, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i)
      check_node(cursor_.integer<Stored>("an element's node"), element);
  }

  void walk_msh1() {
    file_.format = MeshFormat::kMsh1;
    file_.version = "1";
    cursor_.expect("$NOD");
    const std::size_t nodes = cursor_.text_count("the number of nodes", 8);
    for (std::size_t i = 0; i < nodes; ++i) {
      const std::int64_t tag = cursor_.text_integer("a node's number");
      add_node(tag);
      read_coordinates(file_.node_tags.back());
    }
    cursor_.expect("$ENDNOD");
    close_nodes();
    cursor_.expect("$ELM");
    const std::size_t elements = cursor_.text_count("the number of elements", 10);
    for (std::size_t i = 0; i < elements; ++i) {
      const std::int64_t tag = read_element_tag<int>();
      const ElementKind& kind = element_kind(cursor_.text_integer("an element's type"), tag);
      note_element(tag, kind);
      check_group(cursor_.text_integer("an element's physical group"), tag);
      check_group(cursor_.text_integer("an element's entity"), tag);
      const std::int64_t count = cursor_.text_integer("an element's number of nodes");
      if (count != static_cast<std::int64_t>(kind.nodes))
        cursor_.fail("claims " + std::to_string(count) + " nodes where its type has " +
                         std::to_string(kind.nodes),
                     kMendExport, "element " + std::to_string(tag));
      read_element_nodes<int>(tag, kind.nodes);
    }
    close_elements();
    cursor_.expect("$ENDELM");
    keep(0);
    if (!cursor_.at_end()) file_.left_out.emplace_back("what follows $ENDELM");
  }

  void walk_msh() {
    cursor_.expect("$MeshFormat");
    cursor_.end_line();
    file_.version = cursor_.word("the format's version");
    const std::int64_t file_type = cursor_.text_integer("the file type");
    const std::int64_t data_size = cursor_.text_integer("the data size");
    if (file_.version != "2.2" && file_.version != "4.1")
      cursor_.fail("MSH version " + printable(file_.version) + " is not read",
                   "save it as 4.1 (gmsh FILE -save -format msh41 -o mesh.msh)");
    if (file_type != 0 && file_type != 1)
      cursor_.fail("the file type is neither 0 (text) nor 1 (binary)");
    if (data_size != 8) cursor_.fail("the data size is not 8");
    file_.format = file_.version == "2.2" ? MeshFormat::kMsh2 : MeshFormat::kMsh4;
    cursor_.end_line();
    cursor_.binary = file_.binary = file_type == 1;
    if (file_.binary && cursor_.integer<std::int32_t>("the byte order") != 1)
      cursor_.fail("the file was written on a machine with another byte order", "save it as text");
    cursor_.expect("$EndMeshFormat");
    cursor_.end_line();
    keep(0);

    while (!cursor_.at_end()) {
      const std::size_t start = cursor_.position();
      const std::string section(cursor_.word("a section"));
      if (!section.starts_with('$') || section.starts_with("$End"))
        cursor_.fail("found " + printable(section) +
                     " where a section ($Nodes, $Elements) should start");
      const std::string name = section.substr(1);
      if (name == "Nodes" || name == "Elements" || name == "PhysicalNames" ||
          (name == "Entities" && file_.format == MeshFormat::kMsh4)) {
        enter(name);
        cursor_.end_line();
        walk_section(name);
        cursor_.expect("$End" + name);
        keep(start);
      } else if (name == "PartitionedEntities") {
        cursor_.fail("the mesh is partitioned",
                     "save it whole (gmsh: Mesh.PartitionSplitMeshFiles = 0, -part 0)");
      } else if (file_.binary && !seen_elements_) {
        cursor_.fail("section " + printable(section) + " stands before the mesh in a binary file",
                     "save the mesh as text or without it");
      } else {
        file_.left_out.push_back(section);
        if (file_.binary) break;  // its length is unknown, and all that matters was read
        skip_section(name);
      }
    }
    if (!seen_elements_) cursor_.fail("there is no section $Elements", "was the file cut short?");
  }

  void enter(const std::string& name) {
    bool& seen = name == "Nodes"      ? seen_nodes_
                 : name == "Elements" ? seen_elements_
                 : name == "Entities" ? seen_entities_
                                      : seen_names_;
    if (std::exchange(seen, true)) cursor_.fail("section $" + name + " stands twice in the file");
    if (name == "Elements" && !seen_nodes_) cursor_.fail("$Elements stands before $Nodes");
    if (name != "Elements" && name != "Nodes" && seen_nodes_)
      cursor_.fail("$" + name + " stands behind $Nodes");
  }

  void walk_section(const std::string& name) {
    if (name == "PhysicalNames") return walk_names();
    if (name == "Entities") return walk_entities();
    const bool msh2 = file_.format == MeshFormat::kMsh2;
    if (name == "Nodes") {
      msh2 ? walk_nodes2() : walk_nodes4();
      close_nodes();
    } else {
      msh2 ? walk_elements2() : walk_elements4();
      close_elements();
    }
  }

  void skip_section(const std::string& name) {
    const std::string end = "$End" + name;
    for (std::string_view line;;) {
      if (cursor_.remaining() == 0)
        cursor_.fail("section $" + name + " does not end", "was the file cut short?");
      line = cursor_.line_rest();
      while (!line.empty() && line.back() == ' ') line.remove_suffix(1);
      if (line == end) return;
    }
  }

  void walk_names() {  // text in binary files too
    const std::size_t count = cursor_.text_count("the number of physical names", 6);
    for (std::size_t i = 0; i < count; ++i) {
      const std::int64_t dimension = cursor_.text_integer("a physical group's dimension");
      if (dimension < 0 || dimension > 3)
        cursor_.fail("a physical group's dimension is not 0, 1, 2 or 3");
      check_tag(cursor_.text_integer("a physical group's number"));
      std::string_view name = cursor_.line_rest();
      const std::size_t open = name.find_first_not_of(" \t");
      const std::size_t close = name.find_last_not_of(" \t");
      if (name.size() > kLineMax || open == std::string_view::npos || close == open ||
          name[open] != '"' || name[close] != '"')
        cursor_.fail(
            "a physical group's name must stand in double quotes, with at most 250 characters");
      name = name.substr(open + 1, close - open - 1);
      if (std::any_of(name.begin(), name.end(),
                      [](char c) { return c == '"' || (c >= 0 && c < 0x20) || c == 0x7f; }))
        cursor_.fail("a physical group's name holds a quote or a control character");
    }
  }

  void check_tag(std::int64_t tag) {
    if (tag < -std::numeric_limits<std::int32_t>::max() ||
        tag > std::numeric_limits<std::int32_t>::max())
      cursor_.fail("the number " + std::to_string(tag) + " does not fit 32 bits");
  }

  void walk_entities() {
    std::array<std::size_t, 4> counts{};
    for (auto& n : counts) n = cursor_.count<std::uint64_t>("the number of entities", 8);
    for (std::size_t dimension = 0; dimension < 4; ++dimension)
      for (std::size_t i = 0; i < counts[dimension]; ++i) {
        check_tag(cursor_.integer<std::int32_t>("an entity's number"));
        for (int k = 0; k < (dimension == 0 ? 3 : 6); ++k) cursor_.real("an entity's extent");
        walk_tags("the number of physical groups");
        if (dimension > 0) walk_tags("the number of bounding entities");
      }
  }

  void walk_tags(const char* of) {
    const std::size_t tags = cursor_.count<std::uint64_t>(of, cursor_.binary ? 4 : 2);
    for (std::size_t i = 0; i < tags; ++i)
      check_tag(cursor_.integer<std::int32_t>("an entity's number"));
  }

  void walk_nodes2() {
    const std::size_t nodes = cursor_.text_count("the number of nodes", 8);
    if (cursor_.binary) cursor_.end_line();
    for (std::size_t i = 0; i < nodes; ++i) {
      add_node(cursor_.integer<std::int32_t>("a node's number"));
      read_coordinates(file_.node_tags.back());
    }
  }

  void walk_elements2() {
    const std::size_t elements = cursor_.text_count("the number of elements", 8);
    if (cursor_.binary) cursor_.end_line();
    const auto read_tag_count = [&] {
      const std::int64_t tags = cursor_.integer<std::int32_t>("an element's number of tags");
      if (tags < 0 || tags > 16) cursor_.fail("an element has " + std::to_string(tags) + " tags");
      return tags;
    };
    const auto read_rest = [&](std::int64_t tag, std::int64_t tags, const ElementKind& kind) {
      note_element(tag, kind);
      for (std::int64_t k = 0; k < tags; ++k) {
        const std::int64_t number = cursor_.integer<std::int32_t>("an element's tag");
        k < 2 ? check_group(number, tag) : check_tag(number);  // those behind: its partitions
      }
      read_element_nodes<std::int32_t>(tag, kind.nodes);
    };
    if (!cursor_.binary) {
      for (std::size_t i = 0; i < elements; ++i) {
        const std::int64_t tag = read_element_tag<std::int32_t>();
        const ElementKind& kind = element_kind(cursor_.text_integer("an element's type"), tag);
        const std::int64_t tags = read_tag_count();
        read_rest(tag, tags, kind);
      }
      return;
    }
    for (std::size_t done = 0; done < elements;) {
      const ElementKind& kind = element_kind(cursor_.integer<std::int32_t>("an element's type"),
                                             static_cast<std::int64_t>(done + 1));
      const std::size_t following =
          cursor_.count<std::int32_t>("the number of elements that follow", 4);
      const std::int64_t tags = read_tag_count();
      if (following == 0 || following > elements - done)
        cursor_.fail("a block of elements has the wrong length");
      for (std::size_t i = 0; i < following; ++i)
        read_rest(read_element_tag<std::int32_t>(), tags, kind);
      done += following;
    }
  }

  struct Blocks {
    std::size_t blocks, entries;
    std::int64_t max_tag;
  };
  Blocks read_blocks(const char* of) {
    Blocks header{};
    header.blocks = cursor_.count<std::uint64_t>("the number of blocks", 8);
    header.entries = cursor_.count<std::uint64_t>(of, 8);
    cursor_.integer<std::uint64_t>("the smallest number");
    header.max_tag = cursor_.integer<std::uint64_t>("the largest number");
    return header;
  }
  void close_blocks(const Blocks& header, std::size_t found, std::int64_t max_tag) {
    if (found != header.entries || (found > 0 && max_tag != header.max_tag))
      cursor_.fail("the section announces " + std::to_string(header.entries) +
                   " entries up to number " + std::to_string(header.max_tag) + " and holds " +
                   std::to_string(found) + " up to " + std::to_string(max_tag));
  }
  int read_block_entity() {
    const std::int64_t dimension = cursor_.integer<std::int32_t>("a block's dimension");
    if (dimension < 0 || dimension > 3) cursor_.fail("a block's dimension is not 0, 1, 2 or 3");
    check_tag(cursor_.integer<std::int32_t>("a block's entity"));
    return static_cast<int>(dimension);
  }

  void walk_nodes4() {
    const Blocks header = read_blocks("the number of nodes");
    std::uint64_t max_tag = 0;
    for (std::size_t b = 0; b < header.blocks; ++b) {
      const int dimension = read_block_entity();
      const std::int64_t parametric =
          cursor_.integer<std::int32_t>("whether a block is parametric");
      if (parametric != 0 && parametric != 1)
        cursor_.fail("a block's parametric flag is not 0 or 1");
      const std::size_t nodes = cursor_.count<std::uint64_t>("a block's number of nodes", 8);
      const std::size_t first = file_.node_tags.size();
      for (std::size_t i = 0; i < nodes; ++i) {
        add_node(cursor_.integer<std::uint64_t>("a node's number"));
        max_tag = std::max(max_tag, file_.node_tags.back());
      }
      for (std::size_t i = 0; i < nodes; ++i) {
        read_coordinates(file_.node_tags[first + i]);
        for (int k = 0; parametric == 1 && k < dimension; ++k)
          cursor_.real("a parametric coordinate");
      }
    }
    close_blocks(header, file_.node_tags.size(), static_cast<std::int64_t>(max_tag));
  }

  void walk_elements4() {
    const Blocks header = read_blocks("the number of elements");
    std::size_t found = 0;
    std::int64_t max_tag = 0;
    for (std::size_t b = 0; b < header.blocks; ++b) {
      const int dimension = read_block_entity();
      const ElementKind& kind =
          element_kind(cursor_.integer<std::int32_t>("a block's element type"),
                       static_cast<std::int64_t>(found + 1));
      if (kind.dimension != dimension) cursor_.fail("a block's elements do not have its dimension");
      const std::size_t elements = cursor_.count<std::uint64_t>("a block's number of elements", 4);
      for (std::size_t i = 0; i < elements; ++i) {
        const std::int64_t tag = read_element_tag<std::uint64_t>();
        max_tag = std::max(max_tag, tag);
        note_element(tag, kind);
        read_element_nodes<std::uint64_t>(tag, kind.nodes);
      }
      found += elements;
    }
    close_blocks(header, found, max_tag);
  }

  void walk_vtk() {
    file_.format = MeshFormat::kVtk;
    const std::string_view header = cursor_.line_rest();
    file_.version = header.substr(std::string_view("# vtk DataFile Version ").size());
    if (file_.version.empty() || file_.version[0] < '1' || file_.version[0] > '4')
      cursor_.fail(
          "legacy VTK version " + printable(file_.version) + " is not read",
          "save it as version 4.2 or older (ParaView: File > Save Data > File Version 4.2)");
    cursor_.line_rest();  // the title: free text
    const std::string_view encoding = cursor_.word("ASCII or BINARY");
    if (encoding != "ASCII" && encoding != "BINARY")
      cursor_.fail("found " + printable(encoding) + " where ASCII or BINARY should stand");
    cursor_.expect("DATASET");
    const std::string_view dataset = cursor_.word("the kind of dataset");
    if (dataset != "UNSTRUCTURED_GRID")
      cursor_.fail("the dataset is " + printable(dataset) + ", not UNSTRUCTURED_GRID");
    file_.binary = encoding == "BINARY";
    cursor_.big_endian = true;  // VTK's binary files always are
    file_.bytes = "# vtk DataFile Version 3.0\nmesh\n" + std::string(encoding) +
                  "\nDATASET UNSTRUCTURED_GRID\n";

    std::size_t start = vtk_keyword("POINTS");
    const std::size_t points = cursor_.text_count("the number of points", 3);
    const std::string_view type = cursor_.word("the points' type");
    if (type != "float" && type != "double")
      cursor_.fail("the points are of type " + printable(type) + ", not float or double");
    vtk_payload([&] {
      for (std::uint64_t i = 1; i <= points; ++i) {
        file_.node_tags.push_back(i);
        type == "float" ? read_coordinates<float>(i) : read_coordinates<double>(i);
      }
    });
    sorted_tags_ = file_.node_tags;
    keep(start);

    start = vtk_keyword("CELLS");
    const std::size_t cells = cursor_.text_count("the number of cells", 2);
    const std::size_t integers = cursor_.text_count("the size of the cells' list", 1);
    std::vector<std::size_t> cell_nodes(cells);
    vtk_payload([&] {
      std::size_t used = 0;
      for (std::size_t c = 0; c < cells; ++c) {
        const std::int64_t nodes = cursor_.integer<std::int32_t>("a cell's number of points");
        if (nodes < 1 || nodes > 4)
          cursor_.fail(
              "has " + std::to_string(nodes) +
                  " points: only points, lines, triangles, quadrangles and tetrahedra are read",
              kMendExport, "cell " + std::to_string(c));
        cell_nodes[c] = static_cast<std::size_t>(nodes);
        for (std::int64_t i = 0; i < nodes; ++i) {
          const std::int64_t point = cursor_.integer<std::int32_t>("a cell's point");
          check_node(point + 1, static_cast<std::int64_t>(c + 1));
        }
        used += cell_nodes[c] + 1;
      }
      if (used != integers)
        cursor_.fail("the cells' list has " + std::to_string(used) + " entries, not the " +
                     std::to_string(integers) + " announced");
    });
    keep(start);

    start = vtk_keyword("CELL_TYPES");
    if (cursor_.text_count("the number of cell types", 1) != cells)
      cursor_.fail("CELL_TYPES has another length than CELLS");
    vtk_payload([&] {
      for (std::size_t c = 0; c < cells; ++c) {
        const auto element = static_cast<std::int64_t>(c + 1);
        const ElementKind& kind =
            element_kind(cursor_.integer<std::int32_t>("a cell's type"), element);
        count(kind);
        if (kind.nodes != cell_nodes[c])
          cursor_.fail("has " + std::to_string(cell_nodes[c]) + " points where its type has " +
                           std::to_string(kind.nodes),
                       kMendExport, "element " + std::to_string(element));
      }
    });
    keep(start);
    if (!cursor_.at_end()) file_.left_out.emplace_back(cursor_.peek_word());
  }

  // Moves to `keyword`, over the METADATA that some writers put in between; returns its position.
  std::size_t vtk_keyword(std::string_view keyword) {
    if (cursor_.peek_word() == "METADATA")
      while (cursor_.remaining() > 0 && !cursor_.line_rest().empty()) {
      }
    cursor_.skip_space();
    const std::size_t start = cursor_.position();
    cursor_.expect(keyword);
    return start;
  }

  template <typename Walk>
  void vtk_payload(Walk walk) {
    if (file_.binary) cursor_.end_line();
    cursor_.binary = file_.binary;
    walk();
    cursor_.binary = false;
  }

  Cursor cursor_;
  const std::string& path_;
  std::string_view bytes_;
  CheckedMeshFile file_;
  std::vector<std::uint64_t> sorted_tags_, element_tags_;
  std::vector<MeshFault> faults_;
  bool seen_names_ = false, seen_entities_ = false, seen_nodes_ = false, seen_elements_ = false;
};

}  // namespace

CheckedMeshFile check_mesh_bytes(const std::string& path, std::string bytes) {
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(), [](char c) {
    return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  });
  const bool msh = bytes.starts_with("$MeshFormat\n") || bytes.starts_with("$MeshFormat\r\n") ||
                   bytes.starts_with("$NOD\n") || bytes.starts_with("$NOD\r\n");
  const bool vtk = bytes.starts_with("# vtk DataFile Version ");
  if (extension == ".geo")
    fail(path, "a .geo file is a script, not a mesh",
         "mesh it first: gmsh -3 FILE.geo -o mesh.msh");
  if (extension != ".msh" && extension != ".vtk") fail(path, "mesh files end in .msh or .vtk");
  if (bytes.empty()) fail(path, "the file is empty");
  if (!msh && !vtk)
    fail(path,
         "this is not a mesh: it starts with neither $MeshFormat, $NOD nor \"# vtk DataFile "
         "Version\"");
  if (msh != (extension == ".msh"))
    fail(path, "the content does not match the extension", msh ? "name it .msh" : "name it .vtk");
  return Guard(path, bytes).check();
}

CheckedMeshFile check_mesh_file(const std::string& path) {
  std::string bytes;
  try {
    bytes = read_regular_file(path, kMeshFileBytesMax);
  } catch (const FileError& error) {
    fail(path, error.what(), "name a mesh file that can be read");
  }
  return check_mesh_bytes(path, std::move(bytes));
}

}  // namespace sutured::geometry
