# SPDX-License-Identifier: Apache-2.0
# Compiler settings, and the functions that make a folder into a target.
include(GNUInstallDirs)

set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_C_STANDARD 11)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)
# The tree is built in many checkouts on one machine: paths relative to the
# source keep the compiler cache shared and the binaries free of local paths.
add_compile_options("$<$<COMPILE_LANGUAGE:C,CXX>:-ffile-prefix-map=${PROJECT_SOURCE_DIR}=.>")

find_program(SUTURED_CCACHE ccache)
if(SUTURED_CCACHE)
  set(CMAKE_C_COMPILER_LAUNCHER ${CMAKE_COMMAND} -E env CCACHE_BASEDIR=${PROJECT_SOURCE_DIR} CCACHE_NOHASHDIR=1 ${SUTURED_CCACHE})
  set(CMAKE_CXX_COMPILER_LAUNCHER ${CMAKE_C_COMPILER_LAUNCHER})
endif()

if(SUTURED_SANITIZE)
  add_compile_options(-fsanitize=${SUTURED_SANITIZE} -fno-omit-frame-pointer)
  add_link_options(-fsanitize=${SUTURED_SANITIZE})
endif()

find_package(Threads REQUIRED)
find_package(CycloneDDS 0.10 REQUIRED)

add_library(sutured_warnings INTERFACE)
target_compile_options(sutured_warnings INTERFACE
  $<$<COMPILE_LANGUAGE:CXX>:-Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor
    -Woverloaded-virtual -Wcast-qual -Wdouble-promotion -Werror>
  # GCC 12 sees overlapping copies in every `"text" + string` it inlines (its bug 105651).
  $<$<AND:$<COMPILE_LANGUAGE:CXX>,$<CXX_COMPILER_ID:GNU>,$<VERSION_LESS:$<CXX_COMPILER_VERSION>,13>>:-Wno-restrict>)
if(SUTURED_SANITIZE AND CMAKE_CXX_COMPILER_ID STREQUAL GNU)
  # Under sanitizers GCC sees uninitialised values inside std::regex.
  target_compile_options(sutured_warnings INTERFACE $<$<COMPILE_LANGUAGE:CXX>:-Wno-maybe-uninitialized>)
endif()

# sutured_library(name SOURCES a.cpp … [PUBLIC libs…] [PRIVATE libs…])
# A server folder: headers are included as "folder/file.hpp".
function(sutured_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(${name} STATIC ${ARG_SOURCES})
  target_include_directories(${name} PUBLIC ${PROJECT_SOURCE_DIR}/server)
  target_link_libraries(${name} PUBLIC ${ARG_PUBLIC} PRIVATE ${ARG_PRIVATE} sutured_warnings)
endfunction()

# sutured_test(name SOURCES a.cpp … LIBS libs… [LABELS l…] [TIMEOUT s])
# A GoogleTest executable, every case of it a CTest test.
function(sutured_test name)
  cmake_parse_arguments(ARG "" "TIMEOUT" "SOURCES;LIBS;LABELS" ${ARGN})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 120)
  endif()
  add_executable(${name} ${ARG_SOURCES})
  target_include_directories(${name} PRIVATE ${PROJECT_SOURCE_DIR}/tests)
  target_compile_definitions(${name} PRIVATE
    SUTURED_SOURCE_DIR="${PROJECT_SOURCE_DIR}" SUTURED_BINARY_DIR="${PROJECT_BINARY_DIR}")
  target_link_libraries(${name} PRIVATE ${ARG_LIBS} GTest::gtest GTest::gmock GTest::gtest_main sutured_warnings)
  set(properties TIMEOUT ${ARG_TIMEOUT})
  if(ARG_LABELS)
    list(APPEND properties LABELS "${ARG_LABELS}")
  endif()
  if(SUTURED_SANITIZE MATCHES "thread")
    list(APPEND properties
      ENVIRONMENT "TSAN_OPTIONS=suppressions=${PROJECT_SOURCE_DIR}/tests/support/tsan.supp")
  endif()
  gtest_discover_tests(${name} DISCOVERY_TIMEOUT 60 PROPERTIES ${properties})
endfunction()
