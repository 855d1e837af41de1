/* Clients that have connections, in a hash table with chains.
 *
 * Invariant: a client is in the table while its count isn't 0, so there are no more than connections.  The hash is
 * keyed by chance, so that nobody can choose addresses that make one chain of all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/peers.h"

#include <netinet/in.h>
#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "server/base/random.h"

enum { CHAINS = 1024 };

struct key {
    uint64_t bits; /* of the address, its first 64 */
    bool ipv6;
};

struct peer { /* one client that has connections */
    struct key key;
    unsigned count;
    struct peer *next;
};

struct peers {
    pthread_mutex_t lock;
    unsigned most;
    uint64_t salt;
    struct peer *chain[CHAINS];
};

/* An IPv4 address that is written as IPv6 is the IPv4 address. */
static struct key key_of(const struct sockaddr *address) {
    struct sockaddr_in ipv4;
    struct sockaddr_in6 ipv6;
    struct key key = {0};
    if (address->sa_family == AF_INET) {
        memcpy(&ipv4, address, sizeof ipv4);
        key.bits = ipv4.sin_addr.s_addr;
    } else if (address->sa_family == AF_INET6) {
        memcpy(&ipv6, address, sizeof ipv6);
        key.ipv6 = !IN6_IS_ADDR_V4MAPPED(&ipv6.sin6_addr);
        memcpy(&key.bits, ipv6.sin6_addr.s6_addr + (key.ipv6 ? 0 : 12), key.ipv6 ? 8 : 4);
    }
    return key;
}

/* Where the client is linked in, or would be. */
static struct peer **find(struct peers *peers, struct key key) {
    uint64_t hash = (key.bits ^ peers->salt ^ key.ipv6) * UINT64_C(0x9e3779b97f4a7c15);
    hash = (hash ^ hash >> 32) * UINT64_C(0xd6e8feb86659fd93);
    struct peer **at = &peers->chain[hash >> 54];
    while (*at && ((*at)->key.bits != key.bits || (*at)->key.ipv6 != key.ipv6)) at = &(*at)->next;
    return at;
}

struct peers *peers_new(unsigned most) {
    struct peers *peers = calloc(1, sizeof *peers);
    if (!peers) return NULL;
    peers->most = most;
    random_fill(&peers->salt, sizeof peers->salt);
    pthread_mutex_init(&peers->lock, NULL);
    return peers;
}

void peers_free(struct peers *peers) {
    if (!peers) return;
    pthread_mutex_destroy(&peers->lock);
    free(peers);
}

bool peers_enter(struct peers *peers, const struct sockaddr *address) {
    struct key key = key_of(address);
    pthread_mutex_lock(&peers->lock);
    struct peer **at = find(peers, key), *peer = *at;
    if (!peer && (*at = peer = calloc(1, sizeof *peer))) peer->key = key;
    bool enters = peer && peer->count < peers->most;
    if (enters) peer->count++;
    pthread_mutex_unlock(&peers->lock);
    return enters;
}

void peers_leave(struct peers *peers, const struct sockaddr *address) {
    pthread_mutex_lock(&peers->lock);
    struct peer **at = find(peers, key_of(address)), *peer = *at;
    if (--peer->count == 0) {
        *at = peer->next;
        free(peer);
    }
    pthread_mutex_unlock(&peers->lock);
}
