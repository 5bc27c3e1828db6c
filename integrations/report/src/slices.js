// A plane across the volume, along any axis.
import { element } from './elements.js';
import { colourOf, srgb } from './scales.js';

const LONGEST = 480;
const AXES = [ 'x', 'y', 'z' ];

/** `look()`: the mode, its scale and the gain in force. `fly( place )`: goes there. */
export function slices( worker, opened, other, look, fly ) {

	const { min, max } = opened.header;
	const size = max.map( ( x, k ) => x - min[ k ] );
	let [ axis, at, drawn ] = [ 1, 0.5, 0 ];
	const canvas = element( 'canvas.slice', { 'aria-label': 'Slice of the volume', role: 'img' } );
	const said = element( 'output', {} );
	const slider = element( 'input', { type: 'range', min: 0, max: 1, step: 0.005, value: at, 'aria-label': 'Where the slice is', oninput: () => draw( at = Number( slider.value ) ) } );
	const choices = AXES.map( ( name, k ) => element( 'label', {}, element( 'input', { type: 'radio', name: 'axis', checked: k === axis, onchange: () => draw( axis = k ) } ), ` ${ name }` ) );
	let shown = null;
	canvas.addEventListener( 'click', ( event ) => {

		if ( shown === null ) return;
		const box = canvas.getBoundingClientRect();
		const [ column, row ] = [ Math.floor( ( event.clientX - box.left ) / box.width * canvas.width ), Math.floor( ( event.clientY - box.top ) / box.height * canvas.height ) ];
		const k = 3 * ( column + canvas.width * row );
		fly( [ ...shown.positions.slice( k, k + 3 ) ] );

	} );

	async function draw() {

		const number = ++ drawn;
		const [ u, v ] = [ [ 2, 1 ], [ 0, 2 ], [ 0, 1 ] ][ axis ];
		const scale = LONGEST / Math.max( size[ u ], size[ v ], 1e-9 );
		const [ width, height ] = [ u, v ].map( ( k ) => Math.max( 8, Math.round( size[ k ] * scale ) ) );
		const { mode, range, gain } = look();
		const found = await worker( 'slice', { index: opened.index, other, axis, at, width, height, figure: mode.key } );
		if ( number !== drawn ) return;
		const image = new ImageData( width, height );
		for ( let k = 0; k < width * height; k ++ ) {

			const colour = mode.light ? [ 0, 1, 2 ].map( ( c ) => srgb( gain * found.light[ 4 * k + c ] / Math.PI ) ) : colourOf( range, found.light[ 4 * k + 3 ] );
			image.data.set( [ ...colour, 255 ], 4 * k );

		}

		Object.assign( canvas, { width, height } );
		canvas.getContext( '2d' ).putImageData( image, 0, 0 );
		shown = found;
		said.textContent = `${ AXES[ axis ] } = ${ ( min[ axis ] + at * size[ axis ] ).toFixed( 2 ) } m`;

	}

	return { draw, part: element( 'div.slices', {}, element( 'div.row', {}, element( 'span', {}, 'Across ' ), ...choices, slider, said ), canvas, element( 'p.hint', {}, 'Shows what the view shows: light without a direction (its mean over all), or a figure of the nearest node. Click to fly there.' ) ) };

}
