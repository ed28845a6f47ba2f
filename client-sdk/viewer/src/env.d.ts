// SPDX-License-Identifier: Apache-2.0
/** Of the server's WebSocket; a proxy's while the page is being developed. */
declare const __SOCKET_PATH__: string;
