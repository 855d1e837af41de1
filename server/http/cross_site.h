/* What web pages may do with the service.
 *
 * A browser sends what any page tells it to, also to a service on the reader's own machine, where it needs no token.
 * Two checks keep other people's pages out, and leave programs (curl, REST clients) alone:
 *
 *  - Host.  A page whose name server answers with our address would count as ours (DNS rebinding).  Its requests carry
 *    its name, so only names that are ours are answered: addresses and localhost, the one that --listen names, the
 *    machine's own, and those in --allowed-hosts.  Where tokens are wanted a page has none, and every host is answered
 *    unless --allowed-hosts says which; where the service is open to a network (--insecure-open), names without a dot
 *    are taken as well.  Health is told to every host.
 *  - Origin.  What changes something is refused when the browser says that a page of another origin sends it
 *    (Sec-Fetch-Site, else Origin).  --cors-origins names pages that may; they are given the CORS headers too.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_CROSS_SITE_H
#define WHITTLE_SERVER_HTTP_CROSS_SITE_H

#include <stdbool.h>

#include "server/daemon/config.h"
#include "server/http/request.h"

/* Whether the request, which has been matched, names one of our hosts; false: the response (421) is there. */
bool cross_site_admit_host(const struct config *config, const struct request *request, struct response *response);

/* Whether no foreign page sends the request; false: the response (403) is there. */
bool cross_site_admit_origin(const struct config *config, const struct request *request, struct response *response);

/* Answers a browser that asks what a page of --cors-origins may send to a path of ours; false: nothing is asked. */
bool cross_site_preflight(const struct config *config, const struct request *request, struct response *response);

/* Lets a page of --cors-origins read the response. */
void cross_site_share(const struct config *config, const struct request *request, struct response *response);

#endif
