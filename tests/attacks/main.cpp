// SPDX-License-Identifier: GPL-3.0-or-later
// Runs every attack beside an honest device and writes the table: `make attacks`.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <optional>
#include <string>

#include "attacks/arena.hpp"

namespace sutured::attacks {
namespace {

// A peer that fell silent is given up after Cyclone's lease of 10 s, and has to be found again.
constexpr double kRecoveryMax_s = 60.0;

std::string line_of(const char* what, const char* by, const char* reached, const Felt& felt) {
  char text[512];
  std::snprintf(text, sizeof text, "| %s | %s | %s | %llu of %llu | %.0f | %.0f |\n", what, by,
                reached, static_cast<unsigned long long>(felt.lost),
                static_cast<unsigned long long>(felt.sent), felt.p50_us, felt.p99_us);
  return text;
}

int write_table(const std::string& path, const std::string& commit, double seconds,
                const std::string& only) {
  std::string table;
  int successes = 0;
  Arena arena;
  const auto say = [&](const std::string& line) {
    table += line;
    std::fputs(line.c_str(), stdout);
    std::fflush(stdout);
  };
  say(line_of("none: undisturbed", "–", "–", arena.undisturbed(seconds)));
  for (const Attack& attack : attacks()) {
    if (!only.empty() && attack.name != only) continue;
    const Arena::Result result = arena.run(attack, seconds);
    const bool got_in = result.reached.answered > 0 ||
                        (result.reached.read > 0 && !attack.may_read) || result.poses > 0 ||
                        result.leased;
    successes += got_in;
    char reached[96] = "refused";
    if (got_in) {
      std::snprintf(reached, sizeof reached, "GOT IN: %d answers, %d samples read",
                    result.reached.answered, result.reached.read);
    } else if (attack.name == "Replayed" || attack.name == "Forged") {
      std::snprintf(reached, sizeof reached, "refused, %.0f packets/s",
                    static_cast<double>(result.reached.sent) / seconds);
    }
    say(line_of(attack.what.c_str(), attack.by.c_str(), reached, result.felt));
  }
  const std::optional<double> served_again_s = arena.seconds_until_served(kRecoveryMax_s);
  say(line_of("none, once more", "–", "–", arena.undisturbed(seconds)));
  char recovery[128] = "it was never served again";
  if (served_again_s)
    std::snprintf(recovery, sizeof recovery, "it was served again after %.1f s", *served_again_s);
  std::printf("%s\n", recovery);
  if (!only.empty()) return successes + !served_again_s;
  std::ofstream file(path);
  file << "# Attackers\n\n`make attacks` writes this page. `sutured serve` runs secured, as "
          "`suture keys` makes it by default; an honest device sends\n1000 poses a second and "
          "times its forces; beside it each attacker, a process of its own at the level of Cyclone "
          "DDS, past\nthe SDK's checks, tries for "
       << seconds << " s to drive a tool and to read forces. The same cases are tests "
       << "(`ctest -R Attack`), with the\ncounter-check that the attacker does get in with keys "
          "for its tool.\n\nPreset `" SUTURED_PRESET "`, commit "
       << commit
       << ". Attacker, device and server share the processors of one machine: an attack at full "
          "rate\ntakes processor time that it would not take from another machine.\n\n"
          "| Attacker | Refused by | How far it came | Forces lost | p50, µs | p99, µs |\n"
          "|---|---|---|---|---|---|\n"
       << table << "\nAfter the last attack the honest device went on as before: " << recovery
       << ".\n";
  return successes + !served_again_s;
}

}  // namespace
}  // namespace sutured::attacks

int main(int argc, char** argv) {
  CLI::App app("Runs every attack on a secured server and tells what an honest device felt");
  std::string table = "security.md", commit = "unknown", only;
  double seconds = 5.0;
  app.add_option("--table", table, "Markdown file to write");
  app.add_option("--commit", commit, "What was built, for the record");
  app.add_option("--seconds", seconds, "How long each attack lasts");
  app.add_option("--only", only, "Run this one alone, and write no page");
  CLI11_PARSE(app, argc, argv);
  try {
    return sutured::attacks::write_table(table, commit, seconds, only) == 0 ? 0 : 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sutured_attacks: %s\n", error.what());
    return 2;
  }
}
