// SPDX-License-Identifier: Apache-2.0
/** HOST:PORT of a server while the page is being developed; empty in a build. */
declare const __DEV_SERVER__: string;
