// SPDX-License-Identifier: GPL-3.0-or-later
// sutured_bench: the budgets, measured. `make bench` builds the release
// preset and runs it.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <thread>

#include "bench/figures.hpp"
#include "fem/blas_kernels.hpp"

namespace {

std::string machine() {
  std::ifstream file("/proc/cpuinfo");
  std::string line;
  while (std::getline(file, line))
    if (line.starts_with("model name"))
      return line.substr(line.find(": ") + 2) + ", " +
             std::to_string(std::thread::hardware_concurrency()) + " processors, BLAS kernels " +
             std::string(sutured::fem::blas_kernels());
  return "unknown";
}

}  // namespace

int main(int argc, char** argv) {
  sutured::fem::use_best_blas_kernels(argv);
  CLI::App app("Measures the budgets and writes them as one flat JSON object");
  std::string out = "results.json", commit = "unknown";
  std::vector<std::string> only;
  app.add_option("--out", out, "The file to write");
  app.add_option("--commit", commit, "What was built, for the record");
  app.add_option("--only", only,
                 "Measure these alone: step, closure, checkpoint, tissue, tick, fidelity, wakeup, "
                 "roundtrip, checkpoints, security, mesh, viewers");
  std::uint32_t domain = 0;
  std::string session;
  auto* echo = app.add_option("--echo", domain, "Be the bare echo in this DDS domain instead");
  auto* serve = app.add_option("--serve-with-mesh", domain, "Be the server with a large mesh");
  auto* view = app.add_option("--view-mesh", domain, "Be the viewer of that mesh");
  app.add_option("--session", session, "Session of these");
  std::uint16_t port = 0;
  auto* watch = app.add_option("--watch-web", port, "Be fifty viewers of the gateway at this port");
  std::string security = "off";
  app.add_option("--security", security, "Folder of keys of the echo, or off");
  bool thread_model = false;
  app.add_flag("--thread-model", thread_model,
               "Compare where a thread's tension acts instead: a table, no figures");
  std::string fidelity;
  app.add_option("--fidelity", fidelity,
                 "Compare rendered forces with a full re-solve instead: a table, and curves into "
                 "this folder");
  CLI11_PARSE(app, argc, argv);

  using Measure = void (*)(sutured::bench::Figures&);
  const std::vector<std::pair<std::string, Measure>> parts = {
      {"step", sutured::bench::measure_step},
      {"closure", sutured::bench::measure_closure},
      {"checkpoint", sutured::bench::measure_checkpoint},
      {"tissue", sutured::bench::measure_tissue},
      {"tick", sutured::bench::measure_tick},
      {"fidelity", sutured::bench::measure_fidelity},
      {"wakeup", sutured::bench::measure_wakeup},
      {"roundtrip", sutured::bench::measure_roundtrip},
      {"checkpoints", sutured::bench::measure_with_checkpoints},
      {"security", sutured::bench::measure_security},
      {"mesh", sutured::bench::measure_mesh},
      {"viewers", sutured::bench::measure_viewers},
  };
  try {
    if (*echo) sutured::bench::echo(domain, session, security);
    if (*serve) sutured::bench::serve_with_mesh(domain, session);
    if (*view) {
      sutured::bench::view_mesh(domain, session);
      return 0;
    }
    if (*watch) {
      sutured::bench::watch_web(port);
      return 0;
    }
    if (thread_model) {
      sutured::bench::study_thread_model();
      return 0;
    }
    if (!fidelity.empty()) {
      sutured::bench::study_fidelity(fidelity);
      return 0;
    }
    const std::vector<std::pair<std::string, std::string>> facts = {
        {"machine", machine()},
        {"compiler", "gcc " __VERSION__},
        {"preset", SUTURED_PRESET},
        {"commit", commit},
    };
    for (const auto& [name, value] : facts) std::printf("%-9s %s\n", name.c_str(), value.c_str());
    sutured::bench::Figures figures;
    figures.begin();
    for (const auto& [name, measure] : parts)
      if (only.empty() || std::find(only.begin(), only.end(), name) != only.end()) measure(figures);
    figures.write(out, facts);
    std::printf("%d budgets missed; figures in %s\n", figures.missed(), out.c_str());
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sutured_bench: %s\n", error.what());
    return 1;
  }
}
