/* Names of hosts and origins of web pages, as the settings list them and as requests name them.
 *
 * A list is separated by commas.  A host is a name or an address, without port; "*.example.org" stands for every name
 * below example.org.  An origin is "scheme://host[:port]" as browsers send it, without path.  "*" stands for all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_SITE_H
#define WHITTLE_API_SITE_H

#include <stdbool.h>

/* Whether each item of the list may be one; "" is an empty list. */
bool site_hosts_valid(const char *list);
bool site_origins_valid(const char *list);

/* Whether the host of "HOST[:PORT]" is in the list of hosts, by name without regard to case. */
bool site_host_listed(const char *list, const char *authority);

/* Whether the host of "HOST[:PORT]" is one that no foreign name server can make its own: an IP address, localhost, or a
 * name below it. */
bool site_host_is_local(const char *authority);

/* Whether the host has no dot, so that no public name server knows it. */
bool site_host_is_short(const char *authority);

/* Whether it is made of letters, digits and .-_:[] alone, so that it means itself in HTML and in a shell's quotes. */
bool site_host_is_plain(const char *authority);

/* Whether the origin is in the list of origins. */
bool site_origin_listed(const char *list, const char *origin);

/* Whether the origin is that of what is at this authority, by whichever scheme: a proxy may end TLS. */
bool site_origin_is_of(const char *origin, const char *authority);

#endif
