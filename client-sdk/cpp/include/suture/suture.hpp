// SPDX-License-Identifier: Apache-2.0
// Everything of the SDK.
#pragma once

#include "suture/device.hpp"   // IWYU pragma: export
#include "suture/session.hpp"  // IWYU pragma: export
#include "suture/viewer.hpp"   // IWYU pragma: export
