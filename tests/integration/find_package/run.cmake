# SPDX-License-Identifier: GPL-3.0-or-later
# Installs the SDK, builds an outside project against it, and runs that.
# cmake -DBUILD_DIR=… -DSOURCE_DIR=… -DWORK_DIR=… -DCXX=… -DLIBDIR=… [-DCXX_FLAGS=…] -P run.cmake
function(step)
  execute_process(COMMAND ${ARGV} RESULT_VARIABLE result OUTPUT_VARIABLE output ERROR_VARIABLE output)
  if(NOT result EQUAL 0)
    message(FATAL_ERROR "${ARGV}\n${output}")
  endif()
endfunction()

file(REMOVE_RECURSE ${WORK_DIR})
step(${CMAKE_COMMAND} --install ${BUILD_DIR} --component sdk --prefix ${WORK_DIR}/prefix)
# The package must not depend on where it was built or installed first.
file(RENAME ${WORK_DIR}/prefix ${WORK_DIR}/moved)
file(GLOB_RECURSE headers ${WORK_DIR}/moved/include/*)
foreach(header ${headers})
  file(READ ${header} text)
  if(text MATCHES "#include <(dds|Eigen)|suture_v1(_|\\.h)")
    message(FATAL_ERROR "${header} shows what should stay inside: ${CMAKE_MATCH_0}")
  endif()
endforeach()
step(${CMAKE_COMMAND} -S ${SOURCE_DIR}/outside -B ${WORK_DIR}/build -G Ninja
  -DCMAKE_PREFIX_PATH=${WORK_DIR}/moved -DCMAKE_CXX_COMPILER=${CXX} "-DCMAKE_CXX_FLAGS=${CXX_FLAGS}")
step(${CMAKE_COMMAND} --build ${WORK_DIR}/build)
execute_process(COMMAND ${WORK_DIR}/build/outside RESULT_VARIABLE result OUTPUT_VARIABLE output)
message(STATUS "outside: ${output}")
if(NOT result EQUAL 3 OR NOT output MATCHES "no server answers in domain 198")
  message(FATAL_ERROR "expected exit code 3 and the reason, got ${result}: ${output}")
endif()
