/* How many connections each client has.  A client is an IPv4 address, or the /64 of an IPv6 address: whoever has one
 * address of it has them all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_PEERS_H
#define WHITTLE_SERVER_HTTP_PEERS_H

#include <stdbool.h>
#include <sys/socket.h>

struct peers;
struct peer; /* one client that has connections */

/* Returns new, NULL when memory runs out.  most: connections of one client.  peers_free: when all have left; accepts
 * NULL. */
struct peers *peers_new(unsigned most);
void peers_free(struct peers *peers);

/* Whether the client may have another connection.  From any thread, as all of these. */
bool peers_may_enter(struct peers *peers, const struct sockaddr *address);

/* Counts a connection until peers_leave; NULL, which that accepts, when memory runs out. */
struct peer *peers_enter(struct peers *peers, const struct sockaddr *address);
void peers_leave(struct peers *peers, struct peer *peer);

#endif
