// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <suture/suture.hpp>

int main() {
  suture::DeviceOptions options;
  options.domain = 198;
  options.session = "nobody is here";
  options.tool = "driver";
  options.timeout = std::chrono::milliseconds(100);
  try {
    suture::Device device(options);
  } catch (const suture::Error& error) {
    std::puts(error.what());
    return error.code() == suture::ErrorCode::kNoServer ? 3 : 1;
  }
  return 0;
}
