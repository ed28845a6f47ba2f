// SPDX-License-Identifier: Apache-2.0
// The smallest haptic device: it stirs in a small circle and prints what it feels.
#include <cmath>
#include <cstdio>
#include <suture/device.hpp>

int main() {
  try {
    suture::DeviceOptions options;
    options.tool = "driver";
    suture::Device device(options);  // finds the server
    double time_s = 0.0;
    device.run([&](const suture::Force& force, std::chrono::nanoseconds elapsed) {
      time_s += std::chrono::duration<double>(elapsed).count();
      std::printf("\r%7.3f s  %6.3f N", time_s,
                  std::hypot(force.force_n[0], force.force_n[1], force.force_n[2]));
      // A real driver gives force.force_n to its motors here, and reads its encoders.
      suture::Hand hand;
      hand.position_m = {0.01 * std::cos(time_s), 0.01 * std::sin(time_s), 0.02};
      return time_s < 5.0 ? std::optional(hand) : std::nullopt;
    });
  } catch (const suture::Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
