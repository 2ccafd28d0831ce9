"""A hub of our own on this machine: the few requests that Cadenza makes of the Hugging Face hub."""

import base64
import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.parse import unquote, urlsplit

Files = dict[str, bytes]
_API = re.compile(r"/api/(models|datasets)/([\w.-]+/[\w.-]+)(?:/(\w+)/([^/]+))?")
_FILE = re.compile(r"/(datasets/)?([\w.-]+/[\w.-]+)/resolve/([^/]+)/(.+)")
_DOWN = 503


class Hub(ThreadingHTTPServer):
    """The repositories of the hub.

    Attributes:
        commits: (models or datasets, OWNER/NAME) -> its commits in order, by their hash.
        pretended_sizes: sizes [bytes] that are told of files instead of theirs, by name.
        down: True if every request is to fail.
    """

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Requests)
        self.commits: dict[tuple[str, str], dict[str, Files]] = {}
        self.pretended_sizes: dict[str, int] = {}
        self.down = False

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"

    def commit(self, kind: str, repo: str, files: Files) -> str:
        """Add a commit with these files; return its hash."""
        commits = self.commits.setdefault((kind, repo), {})
        content = {**next(reversed(commits.values()), {}), **files}
        digest = hashlib.sha1(f"{len(commits)} {sorted(content)}".encode()).hexdigest()
        commits[digest] = content
        return digest


@contextmanager
def running() -> Iterator[Hub]:
    """Yield a hub without repositories."""
    with Hub() as hub:
        Thread(target=hub.serve_forever, daemon=True).start()
        yield hub
        hub.shutdown()


class _Requests(BaseHTTPRequestHandler):
    server: Hub
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        path = unquote(urlsplit(self.path).path)
        if self.server.down:
            self._send(_DOWN, b"down")
        elif api := _API.fullmatch(path):
            self._about(*api.groups())
        elif file := _FILE.fullmatch(path):
            datasets, repo, revision, name = file.groups()
            self._file("datasets" if datasets else "models", repo, revision, name)
        else:
            self._send(404)

    do_HEAD = do_GET  # noqa: N815

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        path = urlsplit(self.path).path
        if path == "/api/repos/create":
            asked = json.loads(body)
            repo = f"{asked['organization']}/{asked['name']}"
            kind = f"{asked.get('type', 'model')}s"
            self.server.commits.setdefault((kind, repo), {})
            path = f"datasets/{repo}" if kind == "datasets" else repo
            self._json({"url": f"{self.server.url}/{path}", "id": repo, "name": repo})
        elif path == "/api/validate-yaml":
            self._json({"warnings": [], "errors": []})
        else:
            api = _API.fullmatch(path)
            assert api is not None, path
            kind, repo, what, _ = api.groups()
            if what == "preupload":
                names = [file["path"] for file in json.loads(body)["files"]]
                modes = {"uploadMode": "regular", "shouldIgnore": False}
                self._json({"files": [{"path": name, **modes} for name in names]})
            else:
                self._commit(kind, repo, [json.loads(line) for line in body.splitlines()])

    def _commit(self, kind: str, repo: str, lines: list[dict]) -> None:
        values = [line["value"] for line in lines if line["key"] == "file"]
        files = {value["path"]: base64.b64decode(value["content"]) for value in values}
        digest = self.server.commit(kind, repo, files)
        url = f"{self.server.url}/{repo}/commit/{digest}"
        self._json({"success": True, "commitUrl": url, "commitOid": digest, "hookOutput": ""})

    def _commit_at(self, kind: str, repo: str, revision: str | None) -> tuple[str, Files] | None:
        """The hash and the files of a commit; where there is none, says so."""
        commits = self.server.commits.get((kind, repo))
        if not commits:
            self._send(404, error="RepoNotFound")
            return None
        digest = next(reversed(commits)) if revision in (None, "main") else revision
        if digest not in commits:
            self._send(404, error="RevisionNotFound")
            return None
        return digest, commits[digest]

    def _about(self, kind: str, repo: str, what: str | None, revision: str | None) -> None:
        if (commit := self._commit_at(kind, repo, revision)) is None:
            return
        digest, files = commit
        sizes = {name: len(content) for name, content in files.items()}
        if what == "tree":
            listed = [
                {"type": "file", "path": name, "size": size, "oid": _oid(files[name])}
                for name, size in sizes.items()
            ]
            self._json(listed)
        else:
            sizes |= {n: s for n, s in self.server.pretended_sizes.items() if n in sizes}
            siblings = [{"rfilename": name, "size": size} for name, size in sizes.items()]
            self._json({"id": repo, "sha": digest, "siblings": siblings})

    def _file(self, kind: str, repo: str, revision: str, name: str) -> None:
        if (commit := self._commit_at(kind, repo, revision)) is None:
            return
        digest, files = commit
        if name not in files:
            self._send(404, error="EntryNotFound")
        else:
            self._send(200, files[name], commit=digest)

    def _json(self, content: object) -> None:
        self._send(200, json.dumps(content).encode())

    def _send(self, status: int, body: bytes = b"", error: str = "", commit: str = "") -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        if error:
            self.send_header("X-Error-Code", error)
        if commit:
            self.send_header("X-Repo-Commit", commit)
            self.send_header("ETag", f'"{_oid(body)}"')
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Says nothing."""


def _oid(content: bytes) -> str:
    return hashlib.sha1(content).hexdigest()
