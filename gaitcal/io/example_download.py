"""One public file over the network: asked for by name, never more than was announced, and checked before it counts.

This is the only module of gaitcal that asks the internet for anything, on `gaitcal example NAME` alone. The request
holds the address of a public file and the program's name; nothing of the user's data.
"""

from __future__ import annotations

import hashlib
import http.client
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from gaitcal.codes import Code
from gaitcal.errors import InputError, UsageError
from gaitcal.io.example_registry import RemoteFile

TIMEOUT_S = 30.0
"""For a connection, and for each block of a file."""
PAUSES_S = (1.0, 4.0)
"""Before a second and a third try, where the fault may pass."""
_BLOCK = 1 << 16
_PASSING = frozenset({408, 429, 500, 502, 503, 504})
_SCHEMES = ("https", "http", "file")


class _PassingError(Exception):
    """A fault that another try may not meet."""


@dataclass(frozen=True, kw_only=True)
class Connection:
    """How files are asked for."""

    mirror: str | None = None
    """Address that stands for `https://HOST` of every file: `MIRROR/path/of/the/file`."""
    timeout_s: float = TIMEOUT_S
    pauses_s: tuple[float, ...] = PAUSES_S

    def __post_init__(self) -> None:
        if self.mirror is None:
            return
        parts = urlsplit(self.mirror)
        if parts.scheme not in _SCHEMES or not (parts.netloc or parts.scheme == "file"):
            allowed = "an address that begins with https://, http:// or file:///"
            raise UsageError(f"found '{self.mirror[:100]}'; allowed: {allowed}", field="--mirror")

    def address(self, file: RemoteFile) -> str:
        """Where this file is asked for."""
        if self.mirror is None:
            return file.url
        return self.mirror.rstrip("/") + urlsplit(file.url).path

    @property
    def schemes(self) -> tuple[str, ...]:
        """Where a server may send us on to: never from an encrypted address to a plain one."""
        scheme = "https" if self.mirror is None else urlsplit(self.mirror).scheme
        return ("https",) if scheme == "https" else ("https", scheme)


def download(file: RemoteFile, target: Path, connection: Connection, progress: Callable[[int], None]) -> None:
    """Fetch `file` to `target`; `progress` is told the bytes so far.

    Raises
    ------
    InputError
        No network, no such file, another size or SHA-256 than in the registry; `target` is then gone.
    """
    address = connection.address(file)
    for pause in (*connection.pauses_s, None):
        try:
            _fetch(file, address, target, connection, progress)
            break
        except _PassingError as fault:
            target.unlink(missing_ok=True)
            if pause is None:
                tries = len(connection.pauses_s) + 1
                raise InputError(f"{fault}; tried {tries} times", source=address, code=Code.DOWNLOAD) from None
            time.sleep(pause)
        except BaseException:
            target.unlink(missing_ok=True)
            raise


def _fetch(file: RemoteFile, address: str, target: Path, connection: Connection, told: Callable[[int], None]) -> None:
    request = urllib.request.Request(address, headers={"User-Agent": "gaitcal example"})
    opener = urllib.request.build_opener(_Redirects(connection.schemes))
    digest, size = hashlib.sha256(), 0
    try:
        with opener.open(request, timeout=connection.timeout_s) as answer, target.open("wb") as stream:
            while block := answer.read(_BLOCK):
                size += len(block)
                if size > file.bytes:
                    raise InputError(
                        f"is longer than the {file.bytes} bytes announced", source=address, code=Code.DOWNLOAD
                    )
                digest.update(block)
                stream.write(block)
                told(size)
    except urllib.error.HTTPError as error:
        with error:
            _tell_status(error, address)
    except urllib.error.URLError as error:
        _tell_reason(error.reason, address)
    except (http.client.HTTPException, TimeoutError, ConnectionError, ssl.SSLError) as error:
        raise _PassingError(f"the connection broke off ({type(error).__name__})") from None
    if size < file.bytes:
        raise _PassingError(f"broke off after {size} of {file.bytes} bytes")
    if digest.hexdigest() != file.sha256:
        found = f"SHA-256 {digest.hexdigest()[:12]}..., registered {file.sha256[:12]}..."
        raise InputError(
            f"is not the registered file ({found}): it was changed there or on the way",
            source=address,
            code=Code.DOWNLOAD,
        )


def _tell_status(error: urllib.error.HTTPError, address: str) -> None:
    told = f"the server answers {error.code} {error.reason}"
    if error.code in _PASSING:
        raise _PassingError(told) from None
    hint = "; the file is no longer there" if error.code in (404, 410) else ""
    raise InputError(told + hint, source=address, code=Code.DOWNLOAD) from None


def _tell_reason(reason: object, address: str) -> None:
    if isinstance(reason, ssl.SSLCertVerificationError):
        message = f"the server's certificate is not accepted ({reason.verify_message})"
        raise InputError(message, source=address, code=Code.DOWNLOAD) from None
    if isinstance(reason, FileNotFoundError):
        raise InputError("no such file in the mirror", source=address, code=Code.DOWNLOAD) from None
    told = getattr(reason, "strerror", None) or str(reason)
    host = urlsplit(address).netloc or "the mirror"
    raise _PassingError(f"{host} cannot be reached ({told})") from None


class _Redirects(urllib.request.HTTPRedirectHandler):
    def __init__(self, schemes: tuple[str, ...]) -> None:
        self.schemes = schemes

    def redirect_request(  # type: ignore[no-untyped-def]  # as the library calls it
        self, req, fp, code, msg, headers, newurl
    ):
        """Follow to an allowed address only."""
        if urlsplit(newurl).scheme not in self.schemes:
            message = f"the server sends on to '{newurl[:100]}', which is not encrypted; not followed"
            raise InputError(message, source=req.full_url, code=Code.DOWNLOAD)
        return super().redirect_request(req, fp, code, msg, headers, newurl)
