/* How many connections each client has.  A client is an IPv4 address, or the /64 of an IPv6 address: whoever has one
 * address of it has them all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_PEERS_H
#define WHITTLE_SERVER_HTTP_PEERS_H

#include <stdbool.h>
#include <sys/socket.h>

struct peers;

/* Returns new, NULL when memory runs out.  most: connections of one client.  peers_free: when all have left; accepts
 * NULL. */
struct peers *peers_new(unsigned most);
void peers_free(struct peers *peers);

/* Counts a connection of the client's until peers_leave; false: it has as many as it may, or memory runs out.  From any
 * thread, as the other. */
bool peers_enter(struct peers *peers, const struct sockaddr *address);

/* As often as it has entered. */
void peers_leave(struct peers *peers, const struct sockaddr *address);

#endif
