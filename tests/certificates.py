"""Certificates for tests: a lab made by deploy/tls/make-authority, and what careless or hostile people bring."""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from atoll_core.wire.security.credentials import Credentials

SCRIPT = Path(__file__).resolve().parents[1] / "deploy" / "tls" / "make-authority"
HAS_OPENSSL = shutil.which("openssl") is not None and shutil.which("bash") is not None


def make_authority(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Run the script and return what became of it."""
    return subprocess.run([SCRIPT, folder, *options], capture_output=True, text=True, check=False, timeout=60)


@dataclass(frozen=True)
class Lab:
    """A folder that make-authority made."""

    folder: Path

    @classmethod
    def make(cls, folder: Path, *options: str) -> "Lab":
        done = make_authority(folder, *options)
        assert done.returncode == 0, done.stderr
        return cls(folder)

    def files(self, name: str) -> tuple[Path, Path, Path]:
        """Return authority, certificate and key of a name."""
        place = self.folder / name
        return place / "authority.pem", place / "certificate.pem", place / "key.pem"

    def options(self, name: str) -> list[str]:
        """Return the files of a name as options of a program."""
        pairs = zip(("--tls-ca", "--tls-cert", "--tls-key"), self.files(name), strict=True)
        return [str(word) for pair in pairs for word in pair]

    def unchecked(self, name: str, **changes: Path) -> Credentials:
        """Return credentials without looking at them first, as a program of somebody else's would."""
        authority, certificate, key = self.files(name)
        files = {"authority": authority, "certificate": certificate, "key": key, **changes}
        return Credentials(**files, name=name)

    def issue(
        self, name: str, usage: str = "clientAuth", days: int = 1, subject: str | None = None
    ) -> tuple[Path, Path]:
        """Return certificate and key that this lab's authority issues for whatever is asked for; -1 days: expired."""
        place = self.folder / f"issued-{name}"
        place.mkdir()
        key, certificate = place / "key.pem", place / "certificate.pem"
        curve = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", str(key)]
        request, extensions = place / "request.pem", place / "extensions"
        extensions.write_text(f"extendedKeyUsage = {usage}\n")
        _openssl("req", "-new", "-subj", subject or f"/CN={name}", *curve, "-out", str(request))
        signed_by = ["-CA", f"{self.folder}/authority/certificate.pem", "-CAkey", f"{self.folder}/authority/key.pem"]
        options = ["-in", str(request), "-set_serial", "7", "-days", str(days), "-extfile", str(extensions)]
        _openssl("x509", "-req", *options, *signed_by, "-out", str(certificate))
        return certificate, key


def _openssl(*words: str) -> None:
    done = subprocess.run(["openssl", *words], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
