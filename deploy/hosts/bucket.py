#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a backup of many hosts needs of the bucket: that it keeps what is removed, and gives it back.

    bucket.py keep URL          switches versioning on: what is removed stays, as an older version
    bucket.py undelete URL      brings back the objects named on standard input, one a line, where they were removed;
                                a name that ends in / stands for all below it

URL is what whittled's setting `blobs` says: s3://BUCKET/PREFIX?endpoint=URL&region=NAME&style=host.  The keys are in
AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, else in the file that keys= names.
"""
import datetime
import hashlib
import hmac
import os
import sys
import urllib.error
import urllib.parse
import urllib.request
import xml.etree.ElementTree as xml

ENABLED = (b'<VersioningConfiguration xmlns="http://s3.amazonaws.com/doc/2006-03-01/"><Status>Enabled</Status>'
           b"</VersioningConfiguration>")


class Bucket:
    def __init__(self, url):
        parts = urllib.parse.urlsplit(url)
        settings = dict(urllib.parse.parse_qsl(parts.query))
        if parts.scheme != "s3" or "endpoint" not in settings:
            raise SystemExit(f"bucket: {url} is no s3://BUCKET/PREFIX?endpoint=URL")
        self.bucket, self.prefix = parts.netloc, parts.path.strip("/")
        self.prefix += "/" if self.prefix else ""
        self.endpoint, self.region = settings["endpoint"], settings.get("region", "us-east-1")
        self.is_in_path = settings.get("style", "path") == "path"
        if not self.is_in_path:
            self.endpoint = self.endpoint.replace("://", f"://{self.bucket}.", 1)
        if "keys" in settings:
            with open(settings["keys"], encoding="utf-8") as file:
                self.access, self.secret = file.readline().strip().split(":", 1)
        else:
            self.access, self.secret = os.environ["AWS_ACCESS_KEY_ID"], os.environ["AWS_SECRET_ACCESS_KEY"]

    def ask(self, method, key="", query=(), body=b""):
        """The answer's bytes; the request is signed as version 4 of Amazon's signatures has it."""
        def quote(text):
            return urllib.parse.quote(text, safe="-_.~")
        path = "/" + "/".join(map(quote, [self.bucket] * self.is_in_path + key.split("/") * bool(key)))
        text = "&".join(f"{quote(k)}={quote(v)}" for k, v in sorted(query))
        host = urllib.parse.urlsplit(self.endpoint).netloc
        now = datetime.datetime.now(datetime.timezone.utc)
        date, digest = now.strftime("%Y%m%dT%H%M%SZ"), hashlib.sha256(body).hexdigest()
        scope = f"{date[:8]}/{self.region}/s3/aws4_request"
        signed = "host;x-amz-content-sha256;x-amz-date"
        canonical = "\n".join([method, path, text, f"host:{host}", f"x-amz-content-sha256:{digest}", f"x-amz-date:{date}",
                               "", signed, digest])
        to_sign = "\n".join(["AWS4-HMAC-SHA256", date, scope, hashlib.sha256(canonical.encode()).hexdigest()])
        secret = b"AWS4" + self.secret.encode()
        for part in scope.split("/"):
            secret = hmac.new(secret, part.encode(), "sha256").digest()
        signature = hmac.new(secret, to_sign.encode(), "sha256").hexdigest()
        request = urllib.request.Request(
            self.endpoint + path + (f"?{text}" if text else ""), data=body or None, method=method,
            headers={"x-amz-date": date, "x-amz-content-sha256": digest, "Authorization":
                     f"AWS4-HMAC-SHA256 Credential={self.access}/{scope}, SignedHeaders={signed}, Signature={signature}"})
        try:
            with urllib.request.urlopen(request, timeout=60) as reply:
                return reply.read()
        except urllib.error.HTTPError as error:
            raise SystemExit(f"bucket: {method} {path}: {error.code} {error.read()[:300]!r}") from error

    def removed(self):
        """(name below the prefix, version of the mark that removes it) of each object that is removed now."""
        marker = version = None
        while True:
            query = [("versions", ""), ("prefix", self.prefix)]
            query += [("key-marker", marker)] * bool(marker) + [("version-id-marker", version)] * bool(version)
            tree = xml.fromstring(self.ask("GET", query=query))
            place = tree.tag.partition("}")[0] + "}" if tree.tag.startswith("{") else ""
            for mark in tree.iter(f"{place}DeleteMarker"):
                if mark.findtext(f"{place}IsLatest") == "true":
                    yield mark.findtext(f"{place}Key")[len(self.prefix):], mark.findtext(f"{place}VersionId")
            if tree.findtext(f"{place}IsTruncated") != "true":
                return
            marker, version = tree.findtext(f"{place}NextKeyMarker"), tree.findtext(f"{place}NextVersionIdMarker")

    def undelete(self, names):
        """How many were brought back."""
        folders, count = {n for n in names if n.endswith("/")}, 0
        for name, version in list(self.removed()):
            below = {name[:i + 1] for i, c in enumerate(name) if c == "/"}
            if name in names or below & folders:
                self.ask("DELETE", self.prefix + name, [("versionId", version)])
                count += 1
        return count


def main():
    if len(sys.argv) != 3 or sys.argv[1] not in ("keep", "undelete"):
        sys.exit(__doc__)
    bucket = Bucket(sys.argv[2])
    if sys.argv[1] == "keep":
        bucket.ask("PUT", query=[("versioning", "")], body=ENABLED)
    else:
        print(f"bucket: {bucket.undelete({line.strip() for line in sys.stdin})} objects that were removed are back")


if __name__ == "__main__":
    main()
