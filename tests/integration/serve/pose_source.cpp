// SPDX-License-Identifier: GPL-3.0-or-later
// A device to be killed or stopped from outside: pose_source DOMAIN SESSION TOOL X Y Z
#include <cstdio>
#include <cstdlib>
#include <thread>

#include "integration/serve/raw_device.hpp"

int main(int argc, char** argv) {
  if (argc != 7) return 2;
  suture::ParticipantOptions session;
  session.domain = static_cast<std::uint32_t>(std::atoi(argv[1]));
  session.session = argv[2];
  sutured::testing::RawDevice device(session, argv[3]);
  device.move_to(std::atof(argv[4]), std::atof(argv[5]), std::atof(argv[6]));
  std::printf("ready\n");
  std::fflush(stdout);
  for (;;) std::this_thread::sleep_for(std::chrono::hours(1));
}
