// The address of the page with the token as a QR code, for a phone.

import { byId, say } from "./dom.js";

/** Draw the code in the dialog; without a token there is none. */
export async function drawQr(token) {
  byId("qr-box").hidden = !token;
  if (!token) return;
  const { generate } = await import("./vendor/lean-qr.mjs");
  const address = `${location.origin}${location.pathname}#token=${token}`;
  generate(address).toCanvas(byId("qr"), { on: [0, 0, 0], off: [255, 255, 255], pad: 3 });
  const only = ["localhost", "[::1]"].includes(location.hostname) || location.hostname.startsWith("127.");
  say(byId("qr-note"), only ? "This address works on this computer only; start the run with --page-host 0.0.0.0 and open the page by the name of this computer." : "");
}
