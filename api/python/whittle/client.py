# SPDX-License-Identifier: GPL-3.0-or-later
"""A client of the service whittled, of the standard library alone.

    client = whittle.Client("http://127.0.0.1:8080")
    cloud = client.upload("scan.ply", progress=lambda sent, total: None)   # resumes where a connection broke
    job = client.simplify(cloud, ratio=0.1, outputs=["cloud", "mesh"])     # a job; parameters as at /v1/parameters
    job = client.wait(job)                                                 # its document, when it has ended
    client.save(job, "mesh.ply", "mesh.ply")
    vertices = client.array(job, "cloud.ply")                              # numpy, a structured array of its points

Problems of the service are raised as Problem, whose document is theirs (RFC 9457).
"""
import http.client
import json
import os
import time
import urllib.parse

__all__ = ["Client", "Problem"]

PIECE_BYTES = 8 << 20
ABSENT = (502, 503, 504)  # what a proxy says while the service behind it isn't there
TUS = {"Tus-Resumable": "1.0.0"}
TYPES = {"char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4", "float": "<f4",
         "double": "<f8", "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2", "int32": "<i4",
         "uint32": "<u4", "float32": "<f4", "float64": "<f8"}


class Problem(Exception):
    """What the service refused: status, and document, a dict with type, title, detail, errors ..."""

    def __init__(self, status, document):
        super().__init__(f"{status} {document.get('detail') or document.get('title') or ''}".strip())
        self.status, self.document = status, document


def _problem(status, body):
    try:
        document = json.loads(body)
    except ValueError:
        document = {"title": body[:200].decode(errors="replace")}
    return Problem(status, document if isinstance(document, dict) else {"title": str(document)})


def _pause(tried):
    time.sleep(0.1 * 2 ** tried)


def _state(location, headers):
    """(bytes there, the finished cloud's path or None) by a reply of an upload."""
    offset = headers.get("Upload-Offset") or ""
    if not offset.isdigit():
        raise ValueError(f"{location}: the reply has no Upload-Offset, so this is no upload of the service's")
    return int(offset), headers.get("Whittle-Cloud")


class Client:
    """Of the service at url, with a token where it wants one.  retries: how often a broken upload goes on, and a read
    is tried again, without a byte gained in between, after pauses that double; timeout: of each reply, in seconds."""

    def __init__(self, url, token=None, timeout=60, retries=5):
        self.base = urllib.parse.urlsplit(url)
        if self.base.scheme not in ("http", "https"):
            raise ValueError(f"{url}: use a URL of http or https")
        self.token, self.timeout, self.retries = token, timeout, retries
        self._schemas = None  # of the parameters, by name

    # ------------------------------------------------------------------------------------------ requests

    def _target(self, path):
        """The request's target, of a path of the service or of a URL that it gave."""
        parts = urllib.parse.urlsplit(path)
        target = parts.path + ("?" + parts.query if parts.query else "")
        base = self.base.path.rstrip("/")
        return target if parts.scheme or (base and target.startswith(base + "/")) else base + target

    def _open(self, method, path, body=None, headers=None):
        """(connection, reply); the connection is to be closed."""
        kind = http.client.HTTPSConnection if self.base.scheme == "https" else http.client.HTTPConnection
        connection = kind(self.base.hostname, self.base.port, timeout=self.timeout)
        headers = dict(headers or {})
        if self.token:
            headers["Authorization"] = f"Bearer {self.token}"
        try:
            connection.request(method, self._target(path), body=body, headers=headers)
            return connection, connection.getresponse()
        except BaseException:
            connection.close()
            raise

    def request(self, method, path, body=None, headers=None):
        """(status, headers, bytes) of one exchange; raises Problem from 400 on.  A GET is tried again where the
        connection breaks, and where a proxy doesn't reach the service."""
        retries = self.retries if method in ("GET", "HEAD") else 0
        for tried in range(retries + 1):
            try:
                connection, reply = self._open(method, path, body, headers)
                try:
                    data = reply.read()
                finally:
                    connection.close()
                if reply.status not in ABSENT or tried == retries:
                    break
            except (OSError, http.client.HTTPException):
                if tried == retries:
                    raise
            _pause(tried)
        if reply.status >= 400:
            raise _problem(reply.status, data)
        return reply.status, reply.headers, data

    def _document(self, method, path, value=None):
        body = None if value is None else json.dumps(value).encode()
        return json.loads(self.request(method, path, body, {"Content-Type": "application/json"} if body else None)[2])

    # ------------------------------------------------------------------------------------------ clouds

    def _offset(self, location):
        """(bytes there, the finished cloud's id or None) of an upload."""
        return _state(location, self.request("HEAD", location, headers=TUS)[1])

    def _send_piece(self, location, source, sent):
        """Sends what follows; returns the bytes there, the cloud where it is whole, and what may pass if that failed."""
        source.seek(sent)
        piece = source.read(PIECE_BYTES)
        headers = {**TUS, "Upload-Offset": str(sent), "Content-Type": "application/offset+octet-stream"}
        try:
            return *_state(location, self.request("PATCH", location, piece, headers)[1]), None
        except (OSError, http.client.HTTPException) as error:
            return sent, None, error
        except Problem as problem:
            if problem.status not in (*ABSENT, 409, 423):  # the last two: a connection that is dead still has it
                raise
            return sent, None, problem

    def upload(self, source, progress=None, resume=None, started=None):
        """Uploads a path, bytes or a seekable file; returns the cloud's id.  progress(sent, total) is called between
        pieces; started(location) once, with the URL of the upload, which resume= takes in a later run."""
        if isinstance(source, (str, os.PathLike)):
            with open(source, "rb") as file:
                return self.upload(file, progress, resume, started)
        if isinstance(source, (bytes, bytearray, memoryview)):
            import io
            source = io.BytesIO(source)
        total = source.seek(0, os.SEEK_END)
        location = resume or self.request("POST", "/v1/uploads", b"", {**TUS, "Upload-Length": str(total)})[1]["Location"]
        if started:
            started(location)
        tried, most = 0, -1
        sent, cloud = self._offset(location)
        while True:
            if progress:
                progress(sent, total)
            if cloud:
                return cloud.rsplit("/", 1)[-1]
            if sent >= total:
                raise ValueError("the source has changed: the upload is whole, and no cloud came of it")
            tried, most = (0, sent) if sent > most else (tried, most)
            sent, cloud, failed = self._send_piece(location, source, sent)
            if sent > most or cloud:
                continue
            if tried == self.retries:
                raise failed or OSError(f"{location}: the service keeps nothing of what it is sent")
            _pause(tried)
            tried += 1
            sent, cloud = self._offset(location)

    def clouds(self):
        """The documents of the clouds that you have uploaded, newest first; a page of them."""
        return self._document("GET", "/v1/clouds")["clouds"]

    # ------------------------------------------------------------------------------------------ jobs

    def _cloud(self, cloud):
        """The id of a cloud, which is uploaded where it isn't one."""
        is_id = isinstance(cloud, str) and len(cloud) == 64 and not os.path.exists(cloud)
        return cloud if is_id else self.upload(cloud)

    def _params(self, params):
        """Parameters as the service's documents have them: of lists, a text with commas, as the command line and
        whittle.simplify take it, as a list."""
        if not any(isinstance(value, str) for value in params.values()):
            return params
        if self._schemas is None:
            self._schemas = self._document("GET", "/v1/parameters")["properties"]

        def listed(name, value):
            schema = self._schemas.get(name, {})
            if not isinstance(value, str) or schema.get("type") != "array":
                return value
            items = value.split(",")
            try:
                return [float(item) for item in items] if schema["items"]["type"] == "number" else items
            except ValueError:
                return value  # which the service refuses, with what it takes

        return {name: listed(name, value) for name, value in params.items()}

    def simplify(self, cloud, label=None, priority=None, **params):
        """Submits a job for a cloud (an id of upload, or what upload takes), or for a list of clouds that are one;
        returns its document."""
        cloud, *others = [self._cloud(each) for each in (cloud if isinstance(cloud, (list, tuple)) else [cloud])]
        document = {"params": self._params(params)}
        if others:
            document["join"] = [f"/v1/clouds/{each}" for each in others]
        if label is not None:
            document["label"] = label
        if priority is not None:
            document["priority"] = priority
        return self._document("POST", f"/v1/clouds/{cloud}/jobs", document)

    def batch(self, clouds, label=None, priority=None, webhook=None, **params):
        """Submits a job for each of these clouds (ids of upload, or what upload takes), all or none, with one webhook;
        returns the batch's document: its jobs stand in the order of the clouds."""
        document = {"clouds": [f"/v1/clouds/{self._cloud(each)}" for each in clouds], "params": self._params(params)}
        more = {"label": label, "priority": priority, "webhook": webhook}
        document.update((name, value) for name, value in more.items() if value is not None)
        return self._document("POST", "/v1/batches", document)

    def wait_batch(self, batch, progress=None, timeout=None):
        """The document of a batch all of whose jobs have ended, however they have; progress and timeout as in wait."""
        return self._wait(f"/v1/batches/{_id(batch)}", progress, timeout)

    def delete_batch(self, batch):
        """Ends all jobs of a batch, or deletes them where all have ended."""
        return self._document("DELETE", f"/v1/batches/{_id(batch)}")

    def job(self, job):
        """The document of a job, by its id or an older document."""
        return self._document("GET", f"/v1/jobs/{_id(job)}")

    def wait(self, job, progress=None, timeout=None):
        """The document of a job that has ended; progress(document) is called whenever it is read.  Raises Problem where
        it failed, TimeoutError after timeout seconds."""
        document = self._wait(f"/v1/jobs/{_id(job)}", progress, timeout)
        if document["status"] == "failed":
            problem = document.get("problem") or {"title": "the job failed"}
            raise Problem(problem.get("status", 500), problem)
        return document

    def _wait(self, path, progress, timeout):
        """The document at a path when it has ended."""
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            patience = 20 if end is None else max(0, min(20, int(end - time.monotonic())))
            patience = int(min(patience, self.timeout / 2))
            data = self.request("GET", path, headers={"Prefer": f"wait={patience}"})[2]
            document = json.loads(data)
            if progress:
                progress(document)
            if document["status"] not in ("accepted", "running"):
                return document
            if end is not None and time.monotonic() >= end:
                raise TimeoutError(f"{path} is {document['status']}")

    def delete(self, job):
        """Ends a job, or deletes one that has ended."""
        return self._document("DELETE", f"/v1/jobs/{_id(job)}")

    # ------------------------------------------------------------------------------------------ outputs

    def output(self, job, name, points=None):
        """The bytes of an output; points: the coarser cloud of so many of them."""
        query = f"?points={int(points)}" if points else ""
        return self.request("GET", f"/v1/jobs/{_id(job)}/outputs/{urllib.parse.quote(name)}{query}")[2]

    def save(self, job, name, path):
        """Writes an output to a file, piece by piece; it gets its name when it is whole."""
        connection, reply = self._open("GET", f"/v1/jobs/{_id(job)}/outputs/{urllib.parse.quote(name)}")
        partial = f"{os.fspath(path)}.part"
        try:
            if reply.status >= 400:
                raise _problem(reply.status, reply.read())
            with open(partial, "wb") as file:
                while piece := reply.read(1 << 20):
                    file.write(piece)
                if reply.length:
                    raise http.client.IncompleteRead(b"", reply.length)
            os.replace(partial, path)
        finally:
            connection.close()
            if os.path.exists(partial):
                os.remove(partial)

    def array(self, job, name="cloud.ply", points=None):
        """The vertices of a binary PLY output as a structured numpy array: x, y, z and whatever else they have."""
        import numpy
        data = self.output(job, name, points)
        head, _, body = data.partition(b"end_header\n")
        lines = head.decode("ascii", "replace").split("\n")
        if "format binary_little_endian 1.0" not in lines:
            raise ValueError(f"{name} is no binary PLY; encoding=binary makes it one")
        count, fields, vertex = 0, [], False
        for words in (line.split() for line in lines):
            if words[:1] == ["element"]:
                vertex = words[1] == "vertex"
                count = int(words[2]) if vertex else count
            elif vertex and words[:1] == ["property"]:
                if words[1] == "list":
                    raise ValueError(f"{name} has lists in its vertices")
                fields.append((words[2], TYPES[words[1]]))
        return numpy.frombuffer(body, numpy.dtype(fields), count)


def _id(job):
    return job["id"] if isinstance(job, dict) else job
