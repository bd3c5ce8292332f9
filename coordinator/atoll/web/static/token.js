// The view for entering the token. Without a token a user can only read, or sees no jobs.

import { keepToken, session } from "./api.js";
import { faultBox, h, viewHeading } from "./dom.js";

const WHERE = "It is the part after token= in the address that coordinator web (or serve --http, run --web) has printed.";

export default function open(root) {
  const why = session.refusal ?? (session.needs_token ? "This service shows jobs only to users with a token." : "You can only read. With a token you may submit and change jobs.");
  const fault = faultBox();
  const field = h("input", { type: "password", id: "token", autocomplete: "current-password", required: true, size: "36" });
  const form = h("form", { class: "tools", onsubmit: enter }, h("label", { for: "token" }, "Token"), field, h("button", { class: "primary" }, "Continue"));
  root.append(viewHeading("Enter the token"), h("p", {}, why), h("p", { class: "faint" }, WHERE), form, fault);
  field.focus();
  async function enter(event) {
    event.preventDefault();
    const given = field.value.trim().replace(/^.*[?&]token=([^&#]*).*$/, "$1"); // the whole address is accepted, too
    const accepted = await fault.guard(() => keepToken(given));
    if (accepted === undefined) return field.select();
    if (location.hash.startsWith("#/token")) location.hash = "#/jobs";
    return location.reload(); // the page is loaded again for the user of the token
  }
  return { close() {} };
}
