// SPDX-License-Identifier: GPL-3.0-or-later
#include "commands/config_file.hpp"

#define TOML_HEADER_ONLY 0
#include <toml++/toml.h>

#include <CLI/CLI.hpp>
#include <array>
#include <charconv>
#include <map>
#include <sstream>
#include <string_view>
#include <vector>

#include "geometry/regular_file.hpp"

namespace sutured::commands {
namespace {

constexpr std::size_t kFileMax = 1U << 20U;
constexpr std::string_view kServers = "server";

/// One file, and the command whose options it gives.
class ConfigFile {
 public:
  ConfigFile(CLI::App& command, const CLI::Option* itself, const std::string& path)
      : command_(command), itself_(itself), path_(path) {
    try {
      table_ = toml::parse(geometry::read_regular_file(path, kFileMax), path);
    } catch (const toml::parse_error& error) {
      refuse(error.source(), std::string(error.description()), "the rules of TOML: toml.io");
    } catch (const geometry::FileError& error) {
      throw CLI::ConfigError(path + ' ' + error.what() + "\n  name a file of options in --config");
    }
  }

  void apply() {
    std::map<std::string, const toml::node*> values;
    collect(table_, values);
    if (const toml::node* servers = table_.get(kServers); servers != nullptr) {
      const std::string ours = session(values);
      for (auto&& [name, node] : as_table(*servers)) {
        std::map<std::string, const toml::node*> own;
        collect(as_table(node), own);
        if (name.str() != ours) continue;
        if (const auto moved = own.find("session"); moved != own.end())
          refuse(
              moved->second->source(),
              "[server." + ours + "] is the server of session \"" + ours + "\", and names another",
              "leave `session` out here");
        for (const auto& [key, value] : own) values[key] = value;
      }
    }
    for (const auto& [key, value] : values) give(key, *value);
  }

 private:
  [[noreturn]] void refuse(const toml::source_region& place, const std::string& what,
                           const std::string& mend) const {
    std::ostringstream text;
    text << path_ << ':' << place.begin.line << ':' << place.begin.column << ": " << what << '\n'
         << "  " << mend;
    throw CLI::ConfigError(text.str());
  }

  const toml::table& as_table(const toml::node& node) const {
    if (!node.is_table())
      refuse(node.source(), "this stands where a table should",
             "give the server of session NAME its own options below [server.NAME]");
    return *node.as_table();
  }

  /// The option that a key means; null: none.
  CLI::Option* option_of(const std::string& key) const {
    CLI::Option* option = command_.get_option_no_throw("--" + key);
    if (option == nullptr) option = command_.get_option_no_throw(key);
    const bool usable = option != nullptr && option != itself_ && option != command_.get_help_ptr();
    return usable ? option : nullptr;
  }

  std::string known_keys() const {
    std::string keys;
    for (const CLI::Option* option : command_.get_options({}))
      if (option != itself_ && option != command_.get_help_ptr())
        keys += (keys.empty() ? "" : ", ") + option->get_single_name();
    return keys;
  }

  /// Puts the values of a table into `values`, after a look at their keys.
  void collect(const toml::table& table, std::map<std::string, const toml::node*>& values) const {
    for (auto&& [key, node] : table) {
      if (&table == &table_ && key.str() == kServers) continue;
      const std::string name(key.str());
      if (option_of(name) == nullptr)
        refuse(key.source(), "there is no option \"" + name + "\"", "there are " + known_keys());
      values[name] = &node;
    }
  }

  /// The session that this process serves.
  std::string session(const std::map<std::string, const toml::node*>& values) const {
    const CLI::Option* option = option_of("session");
    if (option == nullptr) return {};
    if (option->count() > 0) return option->results().back();
    const auto found = values.find("session");
    return found == values.end() ? "" : found->second->value_or(std::string());
  }

  std::string text_of(const toml::node& node) const {
    if (const auto* text = node.as_string()) return text->get();
    if (const auto* yes = node.as_boolean()) return yes->get() ? "true" : "false";
    if (const auto* number = node.as_integer()) return std::to_string(number->get());
    if (const auto* number = node.as_floating_point()) {
      std::array<char, 32> digits{};
      const auto end = std::to_chars(digits.begin(), digits.end(), number->get()).ptr;
      return {digits.begin(), end};
    }
    refuse(node.source(), "this is no text, number, true or false",
           "write the value as on the command line");
  }

  /// Gives an option what the file says, unless the command line did.
  void give(const std::string& key, const toml::node& node) const {
    CLI::Option& option = *option_of(key);
    if (option.count() > 0) return;
    try {
      if (const toml::array* all = node.as_array()) {
        if (option.get_items_expected_max() <= 1)
          refuse(node.source(), key + " takes one value", "write it without brackets");
        for (const toml::node& one : *all) option.add_result(text_of(one));
        if (all->empty()) return;
      } else {
        option.add_result(text_of(node));
      }
      option.run_callback();
    } catch (const CLI::ConfigError&) {
      throw;
    } catch (const CLI::ParseError& error) {
      refuse(node.source(), error.what(), "see `sutured " + command_.get_name() + " --help`");
    }
  }

  CLI::App& command_;
  const CLI::Option* itself_;
  std::string path_;
  toml::table table_;
};

}  // namespace

CLI::Option* add_config_option(CLI::App& command) {
  // Its function runs before the other options take what they were given: they run in their order.
  return command
      .add_option_function<std::string>(
          "--config",
          [&command](const std::string& path) {
            ConfigFile(command, command.get_option("--config"), path).apply();
          },
          "File of options (TOML), such as /etc/sutured/sutured.toml; what is given here wins")
      ->type_name("FILE");
}

}  // namespace sutured::commands
