/* SPDX-License-Identifier: GPL-3.0-or-later
 * A peer with its own checks disabled: the access control plugin of Cyclone DDS behind a
 * wrapper that permits everything here, and sends whatever permissions ATTACKER_PERMISSIONS
 * names instead of its own. What then keeps it out is the other side. In C: the plugins'
 * headers are. */
#define _GNU_SOURCE
#include <dds/security/dds_security_api.h>
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXPORTED __attribute__((visibility("default")))

static DDS_Security_access_control_get_permissions_credential_token real_token;

static DDS_Security_boolean permitted(void) { return true; }

static char* text_of(const char* path) {
  char* const text = calloc(1, 65536);
  FILE* const file = fopen(path, "r");
  if (file == NULL || text == NULL) abort();
  if (fread(text, 1, 65535, file) == 0) abort();
  fclose(file);
  return text;
}

static DDS_Security_boolean another_token(dds_security_access_control* instance,
                                          DDS_Security_PermissionsCredentialToken* token,
                                          const DDS_Security_PermissionsHandle handle,
                                          DDS_Security_SecurityException* fault) {
  const DDS_Security_boolean done = real_token(instance, token, handle, fault);
  const char* const path = getenv("ATTACKER_PERMISSIONS");
  if (path == NULL) return done;
  for (uint32_t i = 0; i < token->properties._length; ++i) {
    DDS_Security_Property_t* const property = &token->properties._buffer[i];
    if (strcmp(property->name, "dds.perm.cert") != 0) continue;
    free(property->value);
    property->value = text_of(path);
  }
  return done;
}

static void* symbol(const char* name) {
  static void* library;
  if (library == NULL) library = dlopen(getenv("ATTACKER_PLUGIN"), RTLD_NOW);
  void* const found = library == NULL ? NULL : dlsym(library, name);
  if (found == NULL) abort();
  return found;
}

EXPORTED int init_access_control(const char* argument, void** context,
                                 struct ddsi_domaingv* domain) {
  int (*init)(const char*, void**, struct ddsi_domaingv*);
  *(void**)&init = symbol("init_access_control");
  const int result = init(argument, context, domain);
  dds_security_access_control* const plugin = *context;
#define DISABLE(check) *(void**)&plugin->check = (void*)&permitted
  DISABLE(check_create_participant);
  DISABLE(check_create_datawriter);
  DISABLE(check_create_datareader);
  DISABLE(check_create_topic);
  DISABLE(check_remote_participant);
  DISABLE(check_remote_datawriter);
  DISABLE(check_remote_datareader);
  DISABLE(check_remote_topic);
  real_token = plugin->get_permissions_credential_token;
  plugin->get_permissions_credential_token = &another_token;
  return result;
}

EXPORTED int finalize_access_control(void* context) {
  int (*finalize)(void*);
  *(void**)&finalize = symbol("finalize_access_control");
  return finalize(context);
}
