# SPDX-License-Identifier: Apache-2.0
# sutured_completion(program component)
# Installs the completion of bash and zsh for a program whose --help is CLI11's.
function(sutured_completion PROGRAM component)
  set(source ${PROJECT_SOURCE_DIR}/client-sdk/cli/completion)
  configure_file(${source}/suture.bash.in completion/${PROGRAM} @ONLY)
  configure_file(${source}/suture.zsh.in completion/_${PROGRAM} @ONLY)
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/completion/${PROGRAM}
    DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions COMPONENT ${component})
  install(FILES ${CMAKE_CURRENT_BINARY_DIR}/completion/_${PROGRAM}
    DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/vendor-completions COMPONENT ${component})
endfunction()
