// SPDX-License-Identifier: Apache-2.0
// The smallest viewer: it prints the stress of each frame, and events, for five seconds.
#include <algorithm>
#include <cstdio>
#include <suture/viewer.hpp>
#include <thread>

int main() {
  try {
    suture::ViewerCallbacks callbacks;
    callbacks.on_frame = [](const suture::MeshFrame& frame) {
      float peak_pa = 0.0F;
      for (const float stress_pa : frame.von_mises_pa) peak_pa = std::max(peak_pa, stress_pa);
      std::printf("%.*s: step %llu, %zu vertices, %.1f kPa at most\n",
                  static_cast<int>(frame.body.size()), frame.body.data(),
                  static_cast<unsigned long long>(frame.step), frame.position_m.size() / 3,
                  1e-3 * static_cast<double>(peak_pa));
    };
    callbacks.on_event = [](const suture::Event& event) {
      std::printf("%s: %s %s\n", event.kind.c_str(), event.subject.c_str(), event.object.c_str());
    };
    suture::Viewer viewer(suture::SessionOptions{}, callbacks);  // finds the server
    std::this_thread::sleep_for(std::chrono::seconds(5));
    viewer.close();
  } catch (const suture::Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
