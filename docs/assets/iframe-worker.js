// Browsers refuse to start a Worker from file://. The search needs one, so a hidden frame stands in for it.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      this.onmessage = null
      const frame = document.createElement("iframe")
      frame.hidden = true
      frame.srcdoc = "<script>function importScripts(...urls) { " +
        "return urls.reduce((before, url) => before.then(() => new Promise((done, failed) => { " +
        "const script = document.createElement('script'); script.src = url; script.onload = done; " +
        "script.onerror = failed; document.body.appendChild(script) })), Promise.resolve()) } " +
        "window.postMessage = data => window.frameElement.worker.receive(data)" +
        "</" + "script><script src='" + new URL(url, document.baseURI) + "'></" + "script>"
      frame.worker = this
      this.frame = frame
      this.ready = new Promise(done => frame.addEventListener("load", done))
      document.body.appendChild(frame)
    }

    receive(data) {
      const event = new MessageEvent("message", { data })
      this.dispatchEvent(event)
      if (this.onmessage) this.onmessage(event)
    }

    postMessage(data) {
      this.ready.then(() => {
        const inside = this.frame.contentWindow
        inside.dispatchEvent(new inside.MessageEvent("message", { data }))
      })
    }

    terminate() {
      this.frame.remove()
    }
  }
}
